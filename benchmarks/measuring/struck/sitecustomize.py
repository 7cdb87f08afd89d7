"""Lets a thread of a process raise on request; Python loads this by itself where it is on PYTHONPATH.

A process whose command has STRIKE_PROCESS in it looks 200 times a second into STRIKE_FOLDER: it lists its
threads in ``threads``, and once there is a file ``strike``, each thread whose name it holds raises SystemExit
at its next step in Python, which one that waits for a message takes when that comes.
"""

import ctypes
import os
import re
import sys
import threading
import time
from pathlib import Path


class Struck(SystemExit):
    """What the thread raises."""


def name_of(thread: threading.Thread) -> str:
    """The name of a thread, without the time in the name of a recording."""
    return re.sub(r"-\d{8}T\d{6}", "", thread.name)


def watch(folder: Path) -> None:
    """List the threads, and strike the one that is to be struck, once."""
    struck = False
    while True:
        threads = threading.enumerate()
        draft = folder / "threads.draft"
        draft.write_text("\n".join(sorted({name_of(thread) for thread in threads})))
        draft.rename(folder / "threads")
        if not struck and (folder / "strike").exists():
            struck = True
            strike(threads, (folder / "strike").read_text())
        time.sleep(0.005)


def strike(threads: list[threading.Thread], name: str) -> None:
    """Let the threads of this name raise at their next step in Python."""
    for thread in threads:
        if name_of(thread) == name and thread.ident is not None:
            raise_in = ctypes.pythonapi.PyThreadState_SetAsyncExc
            raise_in(ctypes.c_ulong(thread.ident), ctypes.py_object(Struck))


if "STRIKE_FOLDER" in os.environ and os.environ["STRIKE_PROCESS"] in " ".join(sys.orig_argv):
    threading.Thread(
        target=watch, args=(Path(os.environ["STRIKE_FOLDER"]),), name="strike", daemon=True
    ).start()

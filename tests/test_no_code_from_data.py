"""Nothing that is read runs: no pickle, no eval, no shell that is handed somebody's text."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("labhil", "drivers", "sim_drivers", "benchmarks")
MODULES = ("pickle", "cPickle", "_pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib")
BUILTINS = ("eval", "exec", "compile")
CALLS = (
    "os.system",
    "os.popen",
    "subprocess.getoutput",
    "subprocess.getstatusoutput",
    "yaml.load",
    "pd.read_pickle",
    "pandas.read_pickle",
    "code.interact",
)


def faults(text: str) -> Iterator[str]:
    """Describe each place where data could become code, as ``line: what``."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            module = node.module if isinstance(node, ast.ImportFrom) else None
            names = [module] if module else [alias.name for alias in node.names]
            for name in names:
                if name.split(".")[0] in MODULES:
                    yield f"{node.lineno}: import {name}"
        elif isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            if called in BUILTINS or called in CALLS:
                yield f"{node.lineno}: {called}(…)"
            for keyword in node.keywords:
                wanted = keyword.arg in ("shell", "allow_pickle")
                if wanted and ast.unparse(keyword.value) != "False":
                    yield f"{node.lineno}: {called}(…, {keyword.arg}=…)"
            stated = any(keyword.arg == "allow_pickle" for keyword in node.keywords)
            if called in ("np.load", "numpy.load") and not stated:
                yield f"{node.lineno}: {called}(…) without allow_pickle=False"


@pytest.mark.extended
def test_nothing_that_is_read_becomes_code() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{fault}"
        for room in ROOMS
        for path in sorted((ROOT / room).rglob("*.py"))
        for fault in faults(path.read_text(encoding="utf-8"))
    ]
    assert found == []


@pytest.mark.parametrize(
    "text",
    [
        "import pickle",
        "from pickle import loads",
        "import a, marshal",
        "eval(text)",
        "exec(text)",
        "os.system(f'ls {name}')",
        "subprocess.run(text, shell=True)",
        "subprocess.Popen(text, shell=wanted)",
        "np.load(path, allow_pickle=True)",
        "np.load(path)",
        "yaml.load(text)",
    ],
)
def test_what_would_be_found(text: str) -> None:
    assert list(faults(text))


def test_what_is_in_order() -> None:
    text = (
        "import json, re\nre.compile(a)\njson.loads(b)\nsubprocess.run([c])\nnp.load(d, allow_pickle=False)"
    )
    assert list(faults(text)) == []

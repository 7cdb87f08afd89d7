"""The screen in a browser: over a plain socket on every machine, and in Chromium where there is one.

``LABHIL_DRAW_SCREENS=1 pytest tests/tui/test_web.py -m ''`` draws the pictures of the documentation anew.
"""

from __future__ import annotations

import asyncio
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from urllib.parse import urlsplit

import psutil
import pytest

from labhil.bus.latch import read_latch
from labhil.bus.register import registered_processes
from labhil.recording.reader import read_recording
from labhil.service.emergency import release_everywhere

sys.path.insert(0, str(Path(__file__).parent))

from browser import CHROMIUM, Page, chromium

aiohttp = pytest.importorskip("aiohttp", reason="needs labhil's extra web")
pytest.importorskip("textual_serve", reason="needs labhil's extra web")

from labhil.tui.web_gate import user_in_listing, user_of  # noqa: E402 - needs the extra

PATIENCE = 150.0
MOVING = 16_384
PICTURES = Path(__file__).parents[2] / "docs" / "tui"

Talk = Callable[["aiohttp.ClientWebSocketResponse", str], Awaitable[None]]

pytestmark = pytest.mark.timeout(600)


@contextmanager
def served(folder: Path, *options: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """The server and its address; it has to end in order by SIGTERM, with everything that it started."""
    command = [sys.executable, "-P", "-m", "labhil", "tui", "--web", "--port", "0", "--folder", str(folder)]
    process = subprocess.Popen([*command, *options], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield process.stdout.readline().strip(), process
        if process.poll() is None:
            process.terminate()
            assert process.wait(PATIENCE) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


async def status(session: aiohttp.ClientSession, address: str, **headers: str) -> int:
    async with session.get(address, headers=headers, allow_redirects=False) as answer:
        return answer.status


async def seen(link: aiohttp.ClientWebSocketResponse, text: str) -> None:
    """Wait until a text has been sent to the page."""
    whole = b""
    async with asyncio.timeout(PATIENCE):
        while text.encode() not in whole:
            message = await link.receive()
            assert message.type in (aiohttp.WSMsgType.BINARY, aiohttp.WSMsgType.TEXT), f"closed before {text}"
            if message.type is aiohttp.WSMsgType.BINARY:
                whole += message.data


async def closed(link: aiohttp.ClientWebSocketResponse) -> int | None:
    """Wait until the server has closed the page, and return why."""
    async with asyncio.timeout(PATIENCE):
        while not link.closed:
            await link.receive()
    return link.close_code


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(PATIENCE):
        while not condition():
            await asyncio.sleep(0.05)


def in_page(address: str, talk: Talk) -> None:
    """Open the screen as a page does, and talk to it."""

    async def drive() -> None:
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(f"{address}ws?width=100&height=30") as link,
        ):
            await seen(link, "Devices")
            await talk(link, address)

    asyncio.run(drive())


def test_a_page_shows_the_screen_takes_keys_and_ends_with_it(folder: Path) -> None:
    async def talk(link: aiohttp.ClientWebSocketResponse, address: str) -> None:
        await link.send_json(["resize", {"width": 120, "height": 40}])
        await link.send_json(["stdin", "5"])
        await seen(link, "R² 99.99")
        await link.send_json(["ping", "7"])
        await link.send_json(["stdin", "q"])
        assert await closed(link) == 1000

    with served(folder) as (address, _):
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", address)
        in_page(address, talk)


def test_the_page_holds_its_own_fonts_and_scripts_and_goes_into_no_frame(folder: Path) -> None:
    async def look(address: str) -> None:
        async with aiohttp.ClientSession() as session, session.get(address) as answer:
            page = await answer.text()
            assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'none'"
            assert not re.findall(r"https?://", page), "a lab may have no way to the internet"
            parts = re.findall(r'(?:src="|href="|url\(")(static/[^"]+)"', page)
            assert len(parts) == 4
            for part in parts:
                assert await status(session, address + part) == 200

    with served(folder) as (address, _):
        asyncio.run(look(address))


def test_pages_of_other_sites_are_refused(folder: Path) -> None:
    async def look(address: str) -> None:
        async with aiohttp.ClientSession() as session:
            assert await status(session, address) == 200
            assert await status(session, f"{address}ws", Origin="http://elsewhere.example") == 403
            assert await status(session, address, Host="elsewhere.example") == 403

    with served(folder) as (address, _):
        asyncio.run(look(address))


@pytest.mark.extended
def test_what_is_no_message_of_a_page_ends_that_page_only(folder: Path) -> None:
    async def say(address: str, said: str) -> None:
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{address}ws") as link:
            await link.send_str(said)
            assert await closed(link) == 1008

    async def drive(address: str) -> None:
        wrong = ('"x"', '["stdin"]', '["resize", {"width": -1, "height": 20}]', "{", '["stdin", 5]')
        await asyncio.gather(*(say(address, said) for said in wrong))
        async with aiohttp.ClientSession() as session:
            assert await status(session, address) == 200

    with served(folder) as (address, _):
        asyncio.run(drive(address))


@pytest.mark.extended
def test_beyond_the_loopback_a_token_is_needed_once(folder: Path) -> None:
    async def look(address: str) -> None:
        here = re.sub(r"//[^:]+:", "//127.0.0.1:", address)
        bare = here.partition("?")[0]
        # keeps cookies of bare addresses, as browsers do
        jar = aiohttp.CookieJar(unsafe=True)
        async with aiohttp.ClientSession(cookie_jar=jar) as session:
            assert await status(session, bare) == 403
            assert await status(session, f"{bare}ws") == 403
            assert await status(session, f"{bare}?token=guessed") == 403
            assert await status(session, here) == 303
            assert await status(session, bare) == 200
            async with session.ws_connect(f"{bare}ws") as link:
                await seen(link, "Devices")
            assert await status(session, f"{bare}ws", Origin="http://elsewhere.example") == 403

    with served(folder, "--host", "0.0.0.0") as (address, _):
        assert re.fullmatch(r"http://[^/]+:\d+/\?token=[\w-]{43}", address)
        asyncio.run(look(address))


def test_the_user_of_a_connection_is_known() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        with socket.create_connection(listening.getsockname()) as ours:
            assert user_of(ours.getsockname(), listening.getsockname()) == os.getuid()
            assert user_of(ours.getsockname(), ("127.0.0.1", 1)) is None
        assert user_of(("127.0.0.1", 1), listening.getsockname()) is None


def test_a_port_that_somebody_had_before_says_nothing_of_its_user() -> None:
    listing = """  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid
   0: 0100007F:C350 0100007F:1F90 06 00000000:00000000 03:00001770 00000000     0        0 0 3 0
   1: 0100007F:C350 0100007F:1F91 01 00000000:00000000 00:00000000 00000000     0        0 11 1 0
   2: 0100007F:C350 0100007F:1F90 01 00000000:00000000 00:00000000 00000000 65534        0 12 1 0
"""
    assert user_in_listing(listing, ("127.0.0.1", 0xC350), ("127.0.0.1", 0x1F90)) == 65534
    assert user_in_listing(listing, ("127.0.0.1", 0xC350), ("127.0.0.1", 0x1F92)) is None
    assert (
        user_in_listing("\n".join(listing.splitlines()[:2]), ("127.0.0.1", 0xC350), ("127.0.0.1", 0x1F90))
        is None
    )


AS_ANOTHER_USER = """
import os, socket, sys
os.setuid(65534)
with socket.socket() as link:
    link.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    link.bind(("127.0.0.1", int(sys.argv[1])))
    link.connect(("127.0.0.1", int(sys.argv[2])))
    link.sendall(b"GET / HTTP/1.1\\r\\nHost: 127.0.0.1:" + sys.argv[2].encode() + b"\\r\\n\\r\\n")
    print(link.recv(15).decode())
"""


def port_that_root_had() -> int:
    """A port of a connection that root's process closed a moment ago."""
    with socket.create_server(("127.0.0.1", 0)) as listening, socket.socket() as link:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        link.bind(("127.0.0.1", 0))
        link.connect(listening.getsockname())
        far, _ = listening.accept()
        port = int(link.getsockname()[1])
        link.close()
        far.close()
    return port


@pytest.mark.extended
@pytest.mark.skipif(os.getuid() != 0, reason="only root can be another user")
@pytest.mark.parametrize("port", [lambda: 0, port_that_root_had], ids=["any port", "a port that root had"])
def test_another_user_of_this_machine_is_refused(folder: Path, port: Callable[[], int]) -> None:
    with served(folder) as (address, _):
        where = [str(port()), str(urlsplit(address).port)]
        ask = [sys.executable, "-I", "-c", AS_ANOTHER_USER, *where]
        answer = subprocess.run(ask, capture_output=True, text=True, check=True).stdout
    assert answer.strip() == "HTTP/1.1 403 Fo"


@pytest.mark.parametrize("how", ["the page goes", "the server is ended", "the server is killed"])
@pytest.mark.extended
def test_a_run_ends_in_order_with_its_page(bench: Path, how: str) -> None:
    with served(bench) as (address, process):

        async def talk(link: aiohttp.ClientWebSocketResponse, _address: str) -> None:
            await link.send_json(["stdin", "3"])
            await seen(link, "two_sine")
            await link.send_json(["stdin", "\r"])
            reading = asyncio.create_task(
                closed(link)
            )  # who does not read does not answer a ping, and is closed
            await until(lambda: any(p.stat().st_size > MOVING for p in bench.glob("*.mcap.part")))
            if how == "the page goes":
                reading.cancel()
                return
            process.send_signal(signal.SIGTERM if how == "the server is ended" else signal.SIGKILL)
            await reading

        in_page(address, talk)
        asyncio.run(until(lambda: any(bench.glob("*.mcap"))))
        asyncio.run(until(lambda: registered_processes() == ()))
    (path,) = bench.glob("*.mcap")
    end = read_recording(path).metadata["end"]
    assert "terminal UI" in end["reason"]


@pytest.mark.extended
def test_a_killed_server_leaves_no_page_behind(folder: Path) -> None:
    async def talk(link: aiohttp.ClientWebSocketResponse, _address: str) -> None:
        process.kill()
        await closed(link)

    with served(folder) as (address, process):
        server = psutil.Process(process.pid)

        async def pages() -> list[psutil.Process]:
            return server.children(recursive=True)

        started: list[psutil.Process] = []

        async def look(link: aiohttp.ClientWebSocketResponse, address: str) -> None:
            started.extend(await pages())
            await talk(link, address)

        in_page(address, look)
        assert started
        left = psutil.wait_procs(started, timeout=PATIENCE)[1]
        for page in left:
            page.kill()
        assert left == []


@pytest.mark.extended
def test_wrong_use_is_answered_before_anything_is_served(tmp_path: Path) -> None:
    def refused(*options: str) -> str:
        command = [sys.executable, "-P", "-m", "labhil", "tui", "--web", *options]
        told = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE)
        assert told.returncode == 2
        return told.stderr

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert "--port 0 takes a free one" in refused("--port", str(port), "--folder", str(tmp_path))
    assert "expected a folder" in refused("--folder", str(tmp_path / "nowhere"))
    assert "--host" in refused("--host", "no.such.host.invalid", "--folder", str(tmp_path))


def pixel(png: bytes, x: int, y: int) -> tuple[int, int, int]:
    from matplotlib.image import imread

    red, green, blue = (round(float(part) * 255) for part in imread(BytesIO(png), format="png")[y, x][:3])
    return red, green, blue


def is_red(colour: tuple[int, int, int]) -> bool:
    return colour[0] > 120 and colour[1] < 60 and colour[2] < 80


def keep(name: str, picture: bytes) -> None:
    if os.environ.get("LABHIL_DRAW_SCREENS"):
        (PICTURES / name).write_bytes(picture)


async def shown(page: Page, address: str, width: int = 1280, height: int = 800) -> None:
    await page.open(address, width, height)
    await page.wait_for("document.body.classList.contains('-first-byte')")
    async with asyncio.timeout(PATIENCE):  # the field that stops everything is drawn in its corner
        while not is_red(pixel(await page.picture(), width - 20, 4)):
            await asyncio.sleep(0.1)


@pytest.mark.extended
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_in_chromium_keys_and_mouse_work_and_the_stop_reaches_the_machine(folder: Path) -> None:
    async def drive(address: str) -> None:
        async with chromium(folder / "profile") as page:
            await shown(page, address)
            before = await page.picture()
            await page.press("5")
            await asyncio.sleep(1.0)
            results = await page.picture()
            keep("browser.png", results)
            assert results != before
            await page.click(1200, 10)
            await until(lambda: read_latch() is not None)
            await asyncio.sleep(1.0)
            await page.press("q")
            await page.wait_for("document.body.classList.contains('-closed')")
            assert page.complaints == []

    try:
        with served(folder) as (address, _):
            asyncio.run(drive(address))
    finally:
        release_everywhere()


@pytest.mark.extended
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_in_chromium_a_token_opens_the_page_in_light_and_in_small(folder: Path) -> None:
    async def drive(address: str) -> None:
        async with chromium(folder / "profile") as page:
            await shown(page, re.sub(r"//[^:]+:", "//127.0.0.1:", address), 740, 480)
            assert "token" not in await page.value("location.href")
            picture = await page.picture()
            assert min(pixel(picture, 300, 300)) > 200, "dark on light"
            assert page.complaints == []

    with served(folder, "--host", "0.0.0.0", "--light") as (address, _):
        asyncio.run(drive(address))

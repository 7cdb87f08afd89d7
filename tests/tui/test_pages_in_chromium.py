"""Pages in a browser: plots are looked at closely and read, by one script that is ours, and by no other."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from labhil.report.html.page import Page as Written
from labhil.report.html.page import PageSection, write_page
from labhil.report.html.picture import Album
from labhil.report.html.table import Column, facts, table

sys.path.insert(0, str(Path(__file__).parent))

from browser import CHROMIUM, Page, chromium

EVIL = "<script>document.title = 'taken'</script>\"'"

pytestmark = [
    pytest.mark.extended,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to draw pages: apt install chromium"),
]

SVG = "document.querySelector('svg.live')"
TICKS = f"[...{SVG}.querySelectorAll('.own-ticks text')].map((each) => each.textContent)"
READ = f"[...{SVG}.querySelectorAll('.read')].filter((e) => e.getAttribute('visibility') == 'visible')"
PLACES = f"""(() => {{
  const matrix = {SVG}.getScreenCTM();
  const at = (x, y) => {{ const p = new DOMPoint(x, y).matrixTransform(matrix); return [p.x, p.y]; }};
  const plots = JSON.parse({SVG}.dataset.axes);
  return plots.map((t) => [at(t.left, t.top), at(t.left + t.width, t.top + t.height)]);
}})()"""


def figure() -> Figure:
    """Two outputs over one time, beside each other, the second over decades."""
    drawn = Figure(figsize=(8, 3), layout="constrained")
    first, second = drawn.subplots(1, 2)
    t = np.linspace(0.0, 10.0, 201)
    first.plot(t, np.sin(t))
    first.scatter(t[::20], np.sin(t[::20]))
    second.semilogy(t, 10.0 ** (t - 5.0))
    for axes in (first, second):
        axes.set_xlim(0.0, 10.0)
        axes.set_xlabel("t, s")
    first.set_title(EVIL)
    first.set_ylim(-1.0, 1.0)
    second.set_ylim(1e-5, 1e5)
    return drawn


def looked_at(tmp_path: Path, drive: Callable[[Page], Awaitable[None]]) -> None:
    page = Written(
        "Fit", EVIL, EVIL, "plain", (), (PageSection(EVIL, (Album().picture(EVIL, figure),)),), EVIL
    )
    write_page(page, tmp_path / "page.html")

    async def look() -> None:
        async with chromium(tmp_path / "profile") as browser:
            await browser.open(f"file://{tmp_path / 'page.html'}", 1100, 800)
            await browser.wait_for(f"!!{SVG}")
            await drive(browser)
            assert await browser.value("document.title") == EVIL
            assert browser.complaints == []

    asyncio.run(look())


async def mouse(page: Page, kind: str, x: float, y: float, **more: Any) -> None:
    await page.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)


async def dragged(page: Page, number: int, begin: tuple[float, float], end: tuple[float, float]) -> None:
    """From one place of a plot to another, in shares of its width and height from the upper left."""
    (left, top), (right, bottom) = (await page.value(PLACES))[number]
    places = [(left + x * (right - left), top + y * (bottom - top)) for x, y in (begin, end)]
    await mouse(page, "mouseMoved", *places[0])
    await mouse(page, "mousePressed", *places[0], button="left", buttons=1, clickCount=1)
    await mouse(page, "mouseMoved", *places[1], button="left", buttons=1)
    await mouse(page, "mouseReleased", *places[1], button="left", clickCount=1)


async def read(page: Page, number: int, x: float, y: float) -> str:
    (left, top), (right, bottom) = (await page.value(PLACES))[number]
    await mouse(page, "mouseMoved", left + x * (right - left), top + y * (bottom - top))
    (text,) = await page.value(f"{READ}.map((each) => each.textContent)")
    return str(text)


def numbers(text: str) -> list[float]:
    return [float(part.split()[1].replace("\N{MINUS SIGN}", "-")) for part in text.split(",")]


def test_a_pointer_reads_values_on_straight_and_on_logarithmic_axes(tmp_path: Path) -> None:
    async def drive(page: Page) -> None:
        assert numbers(await read(page, 0, 0.25, 0.25)) == pytest.approx([2.5, 0.5], abs=0.03)
        x, y = numbers(await read(page, 1, 0.5, 0.3))
        assert (x, np.log10(y)) == pytest.approx((5.0, 2.0), abs=0.06)

    looked_at(tmp_path, drive)


def test_a_drag_looks_closer_at_one_quantity_in_all_its_plots_and_a_double_click_undoes_it(
    tmp_path: Path,
) -> None:
    async def drive(page: Page) -> None:
        assert await page.value(TICKS) == []
        await dragged(page, 0, (0.19, 0.5), (0.41, 0.5))
        assert await page.value(TICKS) == ["2.0", "2.5", "3.0", "3.5", "4.0"] * 2
        assert numbers(await read(page, 0, 0.5, 0.5)) == pytest.approx([3.0, 0.0], abs=0.02)
        assert numbers(await read(page, 1, 0.5, 0.5))[0] == pytest.approx(3.0, abs=0.02)
        moved = f"[...{SVG}.querySelectorAll('g[transform^=matrix]')].map((e) => e.getAttribute('transform'))"
        assert all(text.startswith("matrix(") for text in await page.value(moved))
        await page.press("0")
        assert await page.value(TICKS) == []
        await dragged(page, 0, (0.2, 0.2), (0.4, 0.8))  # a box: both axes
        assert {"\N{MINUS SIGN}0.5", "0.0", "0.5"} <= set(await page.value(TICKS))
        (left, top), (right, bottom) = (await page.value(PLACES))[0]
        for count in (1, 2):
            for kind in ("mousePressed", "mouseReleased"):
                await mouse(
                    page, kind, 0.5 * (left + right), 0.5 * (top + bottom), button="left", clickCount=count
                )
        assert await page.value(TICKS) == []

    looked_at(tmp_path, drive)


def test_keys_look_closer_too(tmp_path: Path) -> None:
    async def drive(page: Page) -> None:
        await page.value(f"{SVG}.focus()")
        await page.press("+")
        assert numbers(await read(page, 0, 0.0001, 0.5))[0] == pytest.approx(2.0, abs=0.05)
        await page.press("-")
        assert await page.value(TICKS) == []

    looked_at(tmp_path, drive)


WIDTH = 420
CUT = """[...document.querySelectorAll('caption, figcaption, h1, h2, p, dt, dd, .overlay label, td, th')]
  .filter((each) => each.scrollWidth > each.clientWidth + 1 && getComputedStyle(each).display != 'inline')
  .map((each) => each.textContent)"""
CAPTION = "document.querySelector('caption').getBoundingClientRect().right"
TEXT_HEIGHT = f"{SVG}.querySelector('text').getBoundingClientRect().height"


def test_a_narrow_window_cuts_no_words_and_has_legible_figures(tmp_path: Path) -> None:
    long = "Estimates with 99 % intervals against the length of the fitted windows; the band is the final one"
    titles = ("Recording", "RMSE", "Noise floor", "Standard error", "Meaning")
    columns = [Column(title, number=title not in ("Recording", "Meaning")) for title in titles]
    path = "recordings/of_a_campaign/levels-20261125T123553-003.mcap"
    rows = [(path, "0.000426 m", "0.0004369 m", "0.0000012 m", long)]
    parts = (table(long, columns, rows), facts([("calibration.position_offset", "1")]))
    section = PageSection("All", (*parts, Album().picture(long, figure)))
    write_page(Written("Fit", "Fit", long, "plain", (), (section,), ""), tmp_path / "page.html")

    async def look() -> None:
        async with chromium(tmp_path / "profile") as browser:
            await browser.open(f"file://{tmp_path / 'page.html'}", WIDTH, 1600)
            await browser.wait_for(f"!!{SVG}")
            assert await browser.value("document.documentElement.scrollWidth") <= WIDTH
            assert await browser.value(CAPTION) <= WIDTH
            assert await browser.value(CUT) == []
            assert await browser.value(TEXT_HEIGHT) >= 7.0

    asyncio.run(look())

"""The page of a plant as a person uses it, in Debian's chromium; skipped where there is none."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from plant_scale import main as write_plant

if TYPE_CHECKING:
    from selenium.webdriver import Chrome

webdriver = pytest.importorskip("selenium.webdriver")
pytest.importorskip("pyarrow")
DRIVER = shutil.which("chromedriver")
if DRIVER is None:
    pytest.skip("chromedriver is not installed", allow_module_level=True)

JOINTS = 24
PHONE = (390, 844)
DESK = (1280, 900)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    """Without a screen and without a network, with a profile of its own."""
    options = webdriver.ChromeOptions()
    for name in (
        "headless",
        "no-sandbox",
        "disable-gpu",
        "disable-quic",
        "no-first-run",
        "disable-background-networking",
        "disable-component-update",
        "disable-sync",
        f"user-data-dir={tmp_path_factory.mktemp('profile')}",
    ):
        options.add_argument(f"--{name}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options, webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first page of a plant of three types of gearbox."""
    folder = tmp_path_factory.mktemp("plants") / "plant"
    write_plant(folder, JOINTS, 6)
    return folder / "index.html"


@pytest.fixture
def page(browser: Chrome, plant: Path) -> Chrome:
    """That page as it opens."""
    browser.set_window_size(*DESK)
    browser.get(plant.as_uri())
    return browser


def column(page: Chrome, number: int) -> list[str]:
    """What a person sees in a column, from above."""
    return page.execute_script(
        "return [...document.querySelectorAll('#joints tbody tr')].filter(r => r.offsetParent)"
        f".map(r => r.cells[{number}].innerText.split('\\n')[0])"
    )


def press(page: Chrome, heading: str) -> None:
    """Sort by a column."""
    page.find_element("xpath", f"//th/button[text()={json.dumps(heading)}]").click()


def test_it_opens_with_every_joint_the_most_urgent_first_and_nothing_refused(page):
    ranks = column(page, 0)
    given = [int(rank) for rank in ranks if rank != "–"]
    assert len(ranks) == JOINTS
    assert given == sorted(given)
    assert page.find_element("id", "shown").text == f"{JOINTS} of {JOINTS} joints"
    assert page.get_log("browser") == []  # a script that its own policy refuses would stand here


def test_what_is_sought_and_filtered_is_what_stays(page):
    page.find_element("id", "search").send_keys("rv-20 r002")
    kept = list(zip(column(page, 1), column(page, 2), strict=True))
    assert kept
    assert all(name.startswith("R002") and gearbox == "RV-20" for name, gearbox in kept)
    page.find_element("id", "search").clear()
    page.find_element("xpath", "//select[@id='type']/option[text()='HD-25']").click()
    assert column(page, 2) == ["HD-25"] * (JOINTS // 3)
    assert page.find_element("id", "shown").text == f"{JOINTS // 3} of {JOINTS} joints"


def test_who_comes_back_from_a_joint_sees_what_was_asked_for(page):
    page.find_element("xpath", "//select[@id='type']/option[text()='HD-25']").click()
    page.find_element("css selector", "#joints tbody tr:not([hidden]) a").click()
    page.back()
    assert page.find_element("id", "type").get_property("value") == "HD-25"
    assert set(column(page, 2)) == {"HD-25"}


def test_a_column_sorts_by_its_numbers_one_way_and_then_the_other(page):
    press(page, "Gap (mrad)")
    rising = [float(text) for text in column(page, 3)]
    press(page, "Gap (mrad)")
    assert rising == sorted(rising)
    assert [float(text) for text in column(page, 3)] == rising[::-1]


def test_a_joint_leads_to_its_own_report_and_back(page):
    name = column(page, 1)[0].split()[0]
    page.find_element("link text", name).click()
    assert name in page.find_element("tag name", "h1").text
    page.find_element("partial link text", "All joints").click()
    assert len(column(page, 1)) == JOINTS


@pytest.mark.parametrize("size", [PHONE, DESK])
def test_nothing_but_the_table_is_wider_than_the_screen(page, size):
    page.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": size == PHONE},
    )
    try:
        page.get(page.current_url)
        width = page.execute_script("return document.documentElement.scrollWidth")
        assert width <= size[0]
    finally:
        page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_on_paper_every_joint_stands_and_no_tools(page):
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        assert len(column(page, 1)) == JOINTS
        assert not page.find_element("css selector", ".bar-of-tools").is_displayed()
    finally:
        page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})

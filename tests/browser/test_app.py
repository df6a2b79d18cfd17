"""The app as its user sees it, from files that are dropped to a measured step and a file that reads back."""

from __future__ import annotations

import base64
import re
import shutil
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from browser_checks import keep_picture, serious_faults
from playwright.sync_api import Browser, BrowserContext, Page, expect
from SurfaceTopography import open_topography

from app_server import served
from semscape.io.finished_run import read_finished_run
from semscape.metrology.areal import height_parameters
from semscape.metrology.grid import Polygon, Region
from semscape.metrology.level import level
from semscape.metrology.step import step_between_regions
from semscape.report.run import write_run
from synthetic_result import make_result

RUN_MS = 240_000
expect.set_options(timeout=30_000)  # a machine may be busy


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """Give a fresh window of 1280 x 900 px."""
    made = browser.new_context(viewport={"width": 1280, "height": 900}, accept_downloads=True)
    made.set_default_timeout(30_000)
    yield made
    made.close()


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("workspace")


@pytest.fixture(scope="module")
def address(workspace: Path) -> Iterator[str]:
    write_run(make_result(size=(120, 160)), workspace / "made by hand")
    with served(workspace) as (_, url):
        yield url


@pytest.fixture
def page(context: BrowserContext, address: str, request: pytest.FixtureRequest) -> Iterator[Page]:
    """Open the app; at the end no fault has been told and nothing was asked of another machine."""
    opened = context.new_page()
    origin = address.partition("/?")[0]
    faults: list[str] = []
    asked: list[str] = []
    opened.on("pageerror", lambda error: faults.append(str(error)))
    opened.on("console", lambda told: faults.append(told.text) if told.type == "error" else None)
    context.on("request", lambda request: asked.append(request.url))
    opened.goto(address)
    expect(opened).to_have_url(f"{origin}/")  # the token has gone from the address
    yield opened
    keep_picture(opened, f"app-{request.node.name.removeprefix('test_')}")
    assert [url for url in asked if not url.startswith((origin, "blob:", "data:"))] == []
    assert [fault for fault in faults if "status of 4" not in fault] == []  # refusals are told on the page


def drop(page: Page, paths: list[Path]) -> None:
    """Drop files from the disk onto the page, as from a file manager."""
    files = [{"name": path.name, "data": base64.b64encode(path.read_bytes()).decode()} for path in paths]
    transfer = page.evaluate_handle(
        """files => {
            const transfer = new DataTransfer();
            for (const { name, data } of files) {
                transfer.items.add(new File([Uint8Array.from(atob(data), c => c.charCodeAt(0))], name));
            }
            return transfer;
        }""",
        files,
    )
    page.dispatch_event(".drop", "drop", {"dataTransfer": transfer})


def images_of(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix in {".tif", ".jpg", ".png"})


@pytest.fixture
def series(request: pytest.FixtureRequest, master_images: Path) -> Path:
    """Return a measured series where there is one, else a simulated one."""
    try:
        shared: Path = request.getfixturevalue("shared_data")
    except pytest.skip.Exception:
        return master_images
    return shared / "tilt_series" / "potamogeton1"


def test_from_dropped_files_to_a_measured_step_and_an_x3p_that_reads_back(
    page: Page, series: Path, workspace: Path, tmp_path: Path
) -> None:
    drop(page, images_of(series))
    expect(page.locator("tbody tr")).to_have_count(len(images_of(series)))
    expect(page.locator("tbody")).to_contain_text("Zeiss")
    sizes = page.get_by_label("pixel size in µm")
    expect(sizes.first).not_to_have_value("")
    keep_picture(page, "app-table", whole=True)
    page.get_by_text("More settings").click()
    page.get_by_label("Options, one a line").fill("dense.max_pairs=2\ndense.mesh_max_vertices=20000")
    page.get_by_role("button", name="Reconstruct", exact=True).click()
    expect(page.locator("canvas.preview")).to_be_visible(timeout=RUN_MS)
    keep_picture(page, "app-progress", whole=True)
    page.reload()
    expect(page.locator("h1")).to_contain_text(re.compile("good|usable|do not measure"), timeout=RUN_MS)
    page.wait_for_selector(".sv-root canvas")
    keep_picture(page, "app-result", whole=True)
    name = page.url.rpartition("/")[2]
    rows, cols = read_finished_run(workspace / name).height_map.height_um.shape
    third = [cols // 8, rows // 3, cols // 3, 2 * rows // 3]
    other = [cols // 2, rows // 3, 3 * cols // 4, 2 * rows // 3]
    page.get_by_label("Step from region").fill(", ".join(map(str, third)))
    page.get_by_label("Step to region").fill(", ".join(map(str, other)))
    page.get_by_role("button", name="Measure", exact=True).click()
    step = page.locator('tbody[data-group="step"] tr[data-figure="height"] td').first
    expect(step).to_have_text(re.compile(r"^-?\d"), timeout=60_000)
    keep_picture(page, "app-measured", whole=True)
    height_map = read_finished_run(workspace / name).height_map
    masks = [Region(*place).mask((rows, cols)) for place in (third, other)]
    expected = step_between_regions(height_map.height_um, height_map.pixel_size_um, *masks).height
    assert float(step.inner_text()) == pytest.approx(expected, rel=0.02, abs=0.02)
    with page.expect_download() as download:
        page.get_by_role("button", name="Save as X3P").click()
    target = tmp_path / download.value.suggested_filename
    download.value.save_as(target)
    assert target.suffix == ".x3p"
    read = open_topography(str(target)).topography()
    in_um = 1e6 * np.ma.compressed(read.to_unit("m").heights())
    known = height_map.height_um[np.isfinite(height_map.height_um)]
    assert len(in_um) == len(known)
    np.testing.assert_allclose(np.percentile(in_um, [5, 50, 95]), np.percentile(known, [5, 50, 95]), atol=1e-3)


def test_a_polygon_of_the_viewer_is_measured_and_nothing_is_lost_on_reload(page: Page, workspace: Path) -> None:
    page.get_by_role("link", name="made by hand").first.click()
    page.wait_for_selector(".sv-root[data-ready=true]")
    page.click("[data-tool=texture]")
    page.click("button:has-text('Polygon')")
    page.locator("canvas[data-name=map]").focus()
    for key in ["ArrowLeft", "Enter", *["Shift+ArrowRight"] * 4, "Enter", *["Shift+ArrowDown"] * 3, "Enter", "Enter"]:
        page.keyboard.press(key)
    page.get_by_role("button", name="Take the places").click()
    region = page.get_by_label("Region", exact=True)
    expect(region).to_have_value("79, 59, 119, 59, 119, 89")
    page.get_by_role("button", name="Measure", exact=True).click()
    figure = page.locator('[data-figure="Sa"] td').first
    expect(figure).to_be_visible(timeout=60_000)
    height_map = read_finished_run(workspace / "made by hand").height_map
    inside = Polygon(((79, 59), (119, 59), (119, 89))).mask(height_map.height_um.shape)
    levelled = level(np.where(inside, height_map.height_um, np.nan), height_map.pixel_size_um).height
    assert float(figure.inner_text()) == pytest.approx(height_parameters(levelled)["Sa"], rel=0.02)
    keep_picture(page, "app-polygon", whole=True)
    before = figure.inner_text()
    page.reload()
    expect(region).to_have_value("79, 59, 119, 59, 119, 89")
    expect(figure).to_have_text(before)
    expect(page.locator(".sv-table tr[data-name=Sa]")).to_have_count(1)


def test_a_run_that_is_removed_by_mistake_comes_back(page: Page, workspace: Path) -> None:
    shutil.copytree(workspace / "made by hand", workspace / "precious")
    page.get_by_role("button", name="Remove precious").click()
    expect(page.get_by_role("link", name="precious")).to_have_count(0)
    page.get_by_role("button", name="Undo").click()
    expect(page.get_by_role("link", name="precious")).to_be_visible()
    page.get_by_role("button", name="Remove precious").click()
    page.reload()
    page.get_by_text("Removed runs").click()
    keep_picture(page, "app-removed", whole=True)
    page.get_by_role("button", name="Restore precious").first.click()
    expect(page.get_by_role("link", name="precious")).to_be_visible()
    until = time.monotonic() + 10  # the list may know of it before the folder has moved
    while not (workspace / "precious" / "report.html").is_file() and time.monotonic() < until:
        time.sleep(0.05)
    assert (workspace / "precious" / "report.html").is_file()


def test_a_folder_is_chosen(page: Page, master_images: Path) -> None:
    page.set_input_files("input[webkitdirectory]", master_images)
    expect(page.locator("tbody tr")).to_have_count(3)
    expect(page.locator("h1")).to_contain_text(master_images.name)


def test_an_edit_by_keyboard_is_kept_and_undone(page: Page, master_images: Path, workspace: Path) -> None:
    drop(page, images_of(master_images))
    tilts = page.get_by_label("tilt in degrees")
    expect(tilts.first).to_have_value("-6")
    tilts.first.focus()
    page.keyboard.press("Control+A")
    page.keyboard.type("-5,5")
    page.keyboard.press("Enter")
    expect(tilts.nth(1)).to_be_focused()
    expect(tilts.first).to_have_class("told")
    page.reload()
    expect(tilts.first).to_have_value("-5.5")
    name = page.url.rpartition("/")[2]
    assert "tilt_deg = -5.5" in (workspace / "images" / name / "series.toml").read_text()
    tilts.first.focus()
    page.keyboard.press("Control+Z")
    expect(tilts.first).to_have_value("-6")
    page.get_by_role("button", name="Redo").click()
    expect(tilts.first).to_have_value("-5.5")
    tilts.nth(1).fill("120")
    tilts.nth(1).blur()
    expect(page.locator(".notice.bad")).to_contain_text("within ±85")
    expect(tilts.nth(1)).to_have_value("0")
    tilts.nth(2).fill("many")
    tilts.nth(2).blur()
    expect(page.locator(".notice.bad").last).to_contain_text("not a number")


def test_files_that_are_no_series_are_told_in_plain_words(page: Page, master_images: Path, tmp_path: Path) -> None:
    (tmp_path / "notes.docx").write_text("no image")
    drop(page, [tmp_path / "notes.docx"])
    expect(page.locator(".notice.bad")).to_contain_text("no images among these files")
    (tmp_path / "torn.tif").write_bytes(b"II*\0torn")
    drop(page, [*images_of(master_images), tmp_path / "torn.tif", tmp_path / "notes.docx"])
    expect(page.get_by_role("alert").filter(has_text="torn.tif")).to_be_visible()
    expect(page.locator(".notice")).to_contain_text(["notes.docx"])
    keep_picture(page, "app-torn-file", whole=True)
    page.get_by_role("button", name="Remove torn.tif").click()
    expect(page.locator("tbody tr")).to_have_count(3)
    expect(page.get_by_role("alert").filter(has_text="torn.tif")).to_have_count(0)


def test_two_tabs_and_a_reload_see_one_run_that_can_be_cancelled(
    page: Page, context: BrowserContext, master_images: Path
) -> None:
    drop(page, images_of(master_images))
    expect(page.locator("tbody tr")).to_have_count(3)
    page.get_by_role("button", name="Reconstruct", exact=True).click()
    expect(page.locator(".stages .running")).to_have_count(1)
    other = context.new_page()
    other.goto(page.url)
    expect(other.get_by_role("button", name="Cancel")).to_be_visible()
    page.reload()
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator("h1")).to_contain_text("cancelled")
    expect(other.locator("h1")).to_contain_text("cancelled")
    expect(other.get_by_role("button", name="Go on")).to_be_enabled()


def test_the_page_that_cannot_listen_asks(page: Page, context: BrowserContext, workspace: Path) -> None:
    deaf = context.new_page()
    deaf.add_init_script("delete window.EventSource")
    deaf.goto(page.url)
    expect(deaf.locator(".run")).not_to_have_count(0)
    before = deaf.locator(".run").count()
    shutil.copytree(workspace / "made by hand", workspace / f"another {before}")
    expect(deaf.locator(".run")).to_have_count(before + 1, timeout=10_000)
    expect(page.locator(".run")).to_have_count(before + 1, timeout=10_000)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_no_serious_fault(page: Page, master_images: Path, scheme: str, axe: str) -> None:
    page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
    expect(page.locator(".run").first).to_be_visible()
    assert serious_faults(page, axe) == []
    keep_picture(page, f"app-list-{scheme}", whole=True)
    page.get_by_role("link", name="made by hand").first.click()
    page.wait_for_selector(".sv-root canvas")
    page.get_by_role("button", name="Measure", exact=True).click()
    expect(page.locator('[data-figure="Sa"]')).to_be_visible(timeout=60_000)
    assert serious_faults(page, axe) == []
    keep_picture(page, f"app-result-{scheme}", whole=True)
    page.goto(page.url.partition("#")[0] + "#/")
    drop(page, images_of(master_images))
    expect(page.locator("tbody tr")).to_have_count(3)
    expect(page.locator("[aria-busy]")).to_have_count(0)
    assert serious_faults(page, axe) == []
    page.goto(page.url.partition("#")[0] + "api/docs")
    assert serious_faults(page, axe) == []


def test_it_is_readable_at_200_percent(page: Page) -> None:
    """A zoom of 200 % leaves half the pixels: nothing may be cut off or need scrolling sideways."""
    page.set_viewport_size({"width": 640, "height": 450})
    for opened in ("list", "run"):
        if opened == "run":
            page.get_by_role("link", name="made by hand").first.click()
            page.wait_for_selector(".sv-root canvas")
        assert page.evaluate("document.documentElement.scrollWidth") <= 640
        keep_picture(page, f"app-{opened}-200-percent", whole=True)


def test_the_keyboard_alone_opens_a_run(page: Page) -> None:
    expect(page.locator(".run").first).to_be_visible()
    for _ in range(40):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.classList.contains('name')"):
            break
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile("#/run/"))
    expect(page.locator("main")).to_be_focused()


def test_an_address_that_was_cut_is_told(page: Page) -> None:
    page.goto(f"{page.url}#/run/p%C3")
    expect(page.locator("h1")).to_have_text("No such run")
    page.get_by_role("link", name="All runs").click()
    expect(page.locator(".run").first).to_be_visible()


def test_the_report_shows_its_viewer_in_its_sandbox(page: Page, context: BrowserContext) -> None:
    page.goto(page.url + "#/run/made%20by%20hand")
    faults: list[str] = []
    context.on("weberror", lambda error: faults.append(str(error.error)))
    context.on("console", lambda told: faults.append(told.text) if told.type == "error" else None)
    with context.expect_page() as opening:
        page.get_by_role("link", name="Open the report").click()
    report = opening.value
    report.wait_for_selector(".sv-root canvas")
    keep_picture(report, "app-report", whole=True)
    assert faults == []
    with report.expect_download() as download:
        report.evaluate("""() => {
            const link = document.createElement("a");
            link.href = URL.createObjectURL(new Blob(["a"]));
            link.download = "a.csv";
            link.click();
        }""")
    assert download.value.suggested_filename == "a.csv"
    report.close()


def test_a_hostile_report_reaches_nothing(page: Page, context: BrowserContext, workspace: Path) -> None:
    hostile = shutil.copytree(workspace / "made by hand", workspace / "hostile")
    (hostile / "report.html").write_text(
        """<title>waiting</title><script>
        const tries = [
          fetch('/api/runs').then(a => 'fetched ' + a.status),
          fetch('http://127.0.0.1:9/').then(a => 'left'),
          new Promise((yes, no) => { const i = new Image(); i.onload = () => yes('image'); i.onerror = no;
            i.src = '/api/runs/hostile/thumbnail'; }),
          new Promise((yes, no) => { try { localStorage.x = 1; yes('stored'); } catch (e) { no(e); } }),
          new Promise((yes, no) => { try { yes('cookie ' + document.cookie); } catch (e) { no(e); } }),
          new Promise((yes, no) => { try { opener.location.href; yes('opener'); } catch (e) { no(e); } }),
        ];
        Promise.allSettled(tries).then(all => {
          document.title = 'reached: ' + all.map(one => one.value || '').join('');
        });
        </script>"""
    )
    page.goto(page.url + "#/run/hostile")
    asked: list[str] = []
    with context.expect_page() as opening:
        page.get_by_role("link", name="Open the report").click()
    report = opening.value
    report.on("request", lambda request: asked.append(request.url))
    expect(report).to_have_title("reached: ")
    assert not [url for url in asked if ":9/" in url]
    report.close()


def test_a_name_of_a_file_is_never_markup(page: Page, master_images: Path, tmp_path: Path) -> None:
    paths = []
    for number, path in enumerate(images_of(master_images)):
        odd = tmp_path / f"<img src=x onerror=document.title='hacked'> {number}.tif"
        paths.append(shutil.copy(path, odd))
    drop(page, paths)
    expect(page.locator("tbody tr")).to_have_count(3)
    expect(page.locator("tbody th").first).to_contain_text("<img src=x")
    page.goto(page.url.partition("#")[0] + "#/")
    expect(page.locator(".run").first).to_be_visible()
    assert "hacked" not in page.title()


def test_the_end_of_the_server_is_told(context: BrowserContext, tmp_path: Path) -> None:
    with served(tmp_path) as (process, url):
        page = context.new_page()
        page.goto(url)
        expect(page.locator("h1")).to_be_visible()
        threading.Thread(target=process.kill).start()
        expect(page.locator(".trouble")).to_contain_text("Start semscape app again", timeout=15_000)
        time.sleep(0.1)

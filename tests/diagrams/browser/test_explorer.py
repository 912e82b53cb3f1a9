"""The explorer of a small bench in a real browser: filters, order, an episode, two detectors, what is not there."""

import functools
import json

import pytest

from diagrams import bench
from diagrams.browser.explorer import write_explorer, write_replays
from diagrams.monitors.traces import SHOWN
from tests.diagrams import bench_fakes
from tests.diagrams.untrained import save_untrained

EVIL = "</script><img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A whole bench of made-up episodes, all files where bench.py puts them."""
    return bench_in(tmp_path_factory.mktemp("the bench's"), save_untrained(tmp_path_factory.mktemp("weights")))


def bench_in(out, weights, **changes):
    given = dict(
        detectors=["recall"], faults=["A", "payload"], severities=[0.5, 1.0], episodes=2, fit_runs=2,
        calibration_runs=2, recoveries=["planned", "hold"], weights=weights, workers=0, out=out,
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "run_bench_task", bench_fakes.bench_row)
        assert bench.main(bench.BenchArguments(**given | changes)) == 0
    return out


@pytest.fixture
def opened(browser):
    """Opens a page; whatever it complains of in its console fails the test."""
    wrong, pages = [], []

    def open_page(path, scheme="light"):
        page = browser.new_page(viewport={"width": 1400, "height": 1100}, color_scheme=scheme)
        page.on("console", lambda message: wrong.append(message.text) if message.type != "log" else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("requestfailed", lambda request: wrong.append(request.url))
        page.on("dialog", lambda dialog: wrong.append(dialog.message))
        page.set_default_timeout(60_000)
        page.goto(path.as_uri())
        pages.append(page)
        return page

    yield open_page
    for page in pages:
        page.close()
    assert wrong == []


def episodes(page):
    """The episodes that are shown, by the titles of the columns."""
    table = page.get_by_role("table", name="episodes")
    titles = table.locator("thead th").all_inner_texts()
    rows = table.locator("tbody tr").all()
    return [dict(zip(titles, row.locator("td").all_inner_texts(), strict=True)) for row in rows]


def test_filters_and_order(folder, opened):
    page = opened(folder / "explorer.html")
    assert len(episodes(page)) == 3 * 2 * 4 * 2  # detectors, recoveries, kinds, scenes
    page.get_by_label("fault", exact=True).select_option(label="payload")
    page.get_by_label("severity", exact=True).select_option(label="0.5")
    page.get_by_label("detector", exact=True).select_option(label="recall")
    found = episodes(page)
    assert {(row["detector"], row["fault"], row["severity"]) for row in found} == {("recall", "payload", "0.50")}
    assert len(found) == 4
    cells = page.get_by_role("table", name="cells").locator("tbody tr")
    assert cells.count() == 2
    assert "to" in cells.first.locator("td small").first.inner_text()
    page.get_by_label("label", exact=True).select_option(label=found[0]["label"])
    assert {row["label"] for row in episodes(page)} == {found[0]["label"]}
    page.get_by_role("button", name="Show all").click()
    for _ in range(2):
        page.get_by_role("button", name="alarm s").click()
    alarms = [row["alarm s"] for row in episodes(page)]
    there = [float(text) for text in alarms if text]
    assert there == sorted(there, reverse=True)
    assert there
    assert set(alarms[len(there) :]) == {""}  # what never came is last, either way
    assert page.locator("th[aria-sort=descending]").count() == 1
    # A cell sets the filters to its own.
    cells.filter(has_text="oracle").filter(has_text="payload").first.get_by_role("button").click()
    assert {(row["detector"], row["fault"]) for row in episodes(page)} == {("oracle", "payload")}


def test_a_detector_that_was_scored_alone(tmp_path, opened):
    few = dict(loop=["never"], faults=["A"], recoveries=["hold"], episodes=1)
    page = opened(bench_in(tmp_path, save_untrained(tmp_path), **few) / "explorer.html")
    row = next(row for row in episodes(page) if (row["detector"], row["fault"]) == ("recall", "A"))
    assert (row["label"], row["task with"], row["lost s"]) == ("", "not run", "")
    cell = page.get_by_role("table", name="cells").locator("tbody tr").filter(has_text="recall").first
    assert [cell.locator("td").nth(k).inner_text() for k in (6, -7)] == ["", ""]  # tasks done, gap closed
    page.get_by_role("button", name="show: recall, A").first.click()
    side = page.locator(".side").first
    assert side.locator("h3").inner_text() == "recall, hold: scored alone"
    assert side.locator("p").first.inner_text().endswith("It did not act in closed loop.")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_an_episode_with_two_detectors_beside_each_other(folder, opened, scheme, tmp_path):
    write_replays(folder / SHOWN)
    page = opened(folder / "explorer.html", scheme)
    page.get_by_role("button", name="show: recall, payload").last.click()
    sides = page.locator(".side")
    sides.nth(1).wait_for()
    assert sides.locator("h3").all_inner_texts()[0].startswith("recall, hold: ")
    assert sides.locator("h3").all_inner_texts()[1].startswith("oracle, hold: ")
    slider = page.get_by_label("time (arrow keys move it by a tick)")
    assert sides.first.locator(".now").inner_text().startswith("2.2 s: score by gamma")  # at the alarm
    assert "alpha 1.00, mode hold, fault active" in sides.first.locator(".now").inner_text()
    for _ in range(3):
        slider.press("ArrowLeft")
    assert "1.9 s" in sides.nth(1).locator(".now").inner_text()
    assert "alpha 0.00, mode network, fault not active" in sides.nth(1).locator(".now").inner_text()
    # What is drawn: two scores, alpha; the modes one after the other; the fault from 2 s on; the alarm.
    for name, count in (("path", 3), ("rect.network", 2), ("rect.acts", 1), ("rect.fault", 1), ("line.alarm", 1)):
        assert sides.first.locator(f"svg {name}").count() == count, name
    fault, alarm = (sides.first.locator(f"svg {name}") for name in ("rect.fault", "line.alarm"))
    assert float(fault.get_attribute("x")) == pytest.approx(44 + 588 * 20 / 80, abs=0.1)
    assert float(alarm.get_attribute("x1")) == pytest.approx(44 + 588 * 22 / 80, abs=0.1)
    # The picture before that tick is that of tick 15, whose grey is 60.
    assert "1.5 s" in sides.first.locator("figcaption").inner_text()
    assert sides.first.get_by_role("listitem").inner_text() == "0.0 s: <b>subtask 1</b>"
    page.screenshot(path=tmp_path / f"{scheme}.png", full_page=True)
    # Another detector on the same seed; the one that never alarms has one run.
    page.get_by_label("right detector").select_option(label="never, hold")
    page.get_by_text("never, hold: harm").or_(page.get_by_text("never, hold: quiet")).wait_for()
    assert sides.nth(1).locator("svg path").count() == 2
    assert sides.nth(1).locator("code").count() == 1


def test_the_command_for_a_replay_and_the_replay(folder, opened):
    page = opened(folder / "explorer.html")
    page.get_by_role("button", name="show: recall, A").first.click()
    side = page.locator(".side").first
    side.locator("code").nth(1).wait_for()
    command = side.locator("code").nth(1).inner_text()
    key = command.split()[-1]
    assert (folder / SHOWN / f"{key}.js").is_file()
    quoted = str(folder).replace("'", "'\"'\"'")
    assert command == f"python diagrams/bench.py --out '{quoted}' --replay {key}"
    (folder / SHOWN / f"{key}.html").write_text("<title>the desk</title>")
    off = next((folder / SHOWN).glob("off-*.webp")).read_bytes()
    (folder / SHOWN / f"{key}.webp").write_bytes(off)
    try:
        write_replays(folder / SHOWN)
        again = opened(folder / "explorer.html")
        again.get_by_role("button", name="show: recall, A").first.click()
        link = again.locator(".side").first.get_by_role("link")
        link.wait_for()
        assert again.locator(".side").first.locator(".picture").count() == 2
        with again.expect_popup() as popup:
            link.click()
        assert popup.value.title() == "the desk"
    finally:
        for suffix in (".html", ".webp"):
            (folder / SHOWN / f"{key}{suffix}").unlink()
        write_replays(folder / SHOWN)


def row(seed, **changes):
    words = dict(
        detector=EVIL, fault=EVIL, severity=None, recovery="hold", network=EVIL, label="quiet", off=f"off-{seed}"
    )
    numbers = dict(onset_s=None, alarm_s=None, false_alarms=0, length_s=2.0, lost_s=0.0)
    return words | numbers | dict(seed=seed, needed=False, success=True, acts=False) | changes


def test_text_of_the_data_stays_text_and_long_tables_come_in_parts(opened, tmp_path):
    of = functools.partial(row, detector=EVIL)
    cell = dict(detector=EVIL, fault=EVIL, severity=None, recovery="hold", n=250, tasks=None)
    cell |= {"gap_closed": {"value": 0.5, "interval": [float("nan"), 1.0], "exact": False}}
    write_explorer(tmp_path, [cell], [of(seed) for seed in range(250)], {EVIL: {EVIL: 2.0}}, 30.0, 0.1)
    write_replays(tmp_path / SHOWN)
    trace = dict(hash="", ticks=20, acting=[], events=[[0.0, EVIL]], scores={EVIL: [0.5] * 20})
    trace |= {"pictures": {"count": 4, "columns": 10, "every": 5}}
    (tmp_path / SHOWN / "off-3.js").write_text(f"episode('off-3', {json.dumps(trace)})")
    bench_fakes_picture = bench_fakes.pictures_file(bench_fakes.shown(20, False)[0])
    (tmp_path / SHOWN / "off-3.webp").write_bytes(bench_fakes_picture)
    page = opened(tmp_path / "explorer.html")
    assert page.get_by_role("table", name="cells").locator("td small").inner_text() == "to 1.00"
    assert len(episodes(page)) == 100
    page.get_by_role("button", name="More rows").last.click()
    found = episodes(page)
    assert len(found) == 200
    assert found[0]["detector"] == EVIL
    page.get_by_role("button", name=f"show: {EVIL}, {EVIL}, seed 3", exact=True).click()
    page.get_by_role("listitem").first.wait_for()
    assert page.get_by_role("listitem").first.inner_text() == f"0.0 s: {EVIL}"
    assert EVIL in page.locator("#episode-title").inner_text()
    assert page.locator("img").count() == 0


def test_a_trace_that_is_not_there_is_named(browser, tmp_path):
    write_explorer(tmp_path, [], [row(1)], {}, 30.0, 0.1)
    write_replays(tmp_path / SHOWN)
    page = browser.new_page()
    page.goto((tmp_path / "explorer.html").as_uri())
    page.get_by_role("button", name="show:").click()
    page.get_by_text("Its trace is not in the folder explorer beside this page").first.wait_for()
    page.close()

"""`holdfast report`: a page about a replay, from its files alone."""

import json
import re
import shutil
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from chromium import DESKTOP, PHONE, check_page, needs_chromium
from chromium import Page as BrowserPage
from click.testing import CliRunner

from holdfast.cli import holdfast
from holdfast.errors import ConfigError, HoldfastError, RecordingError
from holdfast.recording.mcap_writer import McapWriter
from holdfast.recording.tum import read_tum
from holdfast.replay.results import read_run
from holdfast.report.page import render
from holdfast.report.run_record import Measurements
from holdfast.report.single_run import single_run_page
from holdfast.report.timeline import lost_intervals
from holdfast.ros.messages import BIAS_KEYS


def call(*arguments: str | Path) -> str:
    result = CliRunner().invoke(holdfast, [*map(str, arguments)], catch_exceptions=False, standalone_mode=False)
    assert result.exit_code == 0
    return result.output


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "yard"
    call("simulate", "quick", "-o", folder, "--seed", "5")
    call("replay", folder, "-c", folder / "config.yaml", "-o", folder / "out")
    return folder


@pytest.fixture(scope="module")
def page(simulated: Path) -> tuple[str, dict]:
    file = simulated / "out" / "report.html"
    call("report", simulated / "out", "--reference", simulated / "truth")
    return file.read_text(encoding="utf-8"), json.loads(file.with_suffix(".json").read_text(encoding="utf-8"))


def test_the_errors_are_those_that_evaluate_finds(page, simulated: Path, tmp_path: Path):
    truth = simulated / "truth" / "imu_in_world.tum"
    call("evaluate", simulated / "out" / "imu_in_world.tum", truth, "--json", tmp_path / "judged.json")
    judged = json.loads((tmp_path / "judged.json").read_text())["alignments"]["none"]["scores"]["all"]["ape"]
    table = page[1]["tables"]["errors"]
    found = {(row[0], row[1]): dict(zip(table["columns"], row, strict=True)) for row in table["rows"]}
    angles = ((f"{name} [deg]", f"{name}_deg") for name in ("roll", "pitch", "yaw"))
    for ours, theirs in (("horizontal [m]", "horizontal_m"), ("vertical [m]", "vertical_m"), *angles):
        for name in ("mean", "std", "rms", "median", "p95", "max"):
            assert found[ours, "all"][name] == pytest.approx(judged[theirs][name], rel=1e-6)


def test_what_was_learnt_stands_beside_what_the_file_says(page):
    table = page[1]["tables"]["learnt"]
    rows = {(row[0], row[1]): dict(zip(table["columns"], row, strict=True)) for row in table["rows"]}
    clock = rows["lidar", "clock"]
    assert clock["key"] == "sensors.lidar.time_offset_s" and clock["configured"] == 0.0 and clock["sigma"] > 0.0
    assert rows["lidar", "translation noise"]["unit"] == "m"


def test_the_outage_is_where_the_scenario_put_it(page, simulated: Path):
    run = read_run(simulated / "out", None)
    (lost,) = lost_intervals(run.events, run.start_ns, run.end_s)
    # GNSS is silent from 12 to 16 s; the gate waits some epochs before the loss, and some before it trusts again
    assert 12.0 < lost.start_s < 14.0
    assert 15.9 < lost.end_s < 18.0
    assert "1 outage." in page[1]["lead"]


def test_every_switch_has_its_reason_in_words(page):
    texts = [row[2] for row in page[1]["tables"]["switches"]["rows"]]
    assert any("GNSS is lost" in text and "fallback graph takes over" in text for text in texts)
    assert any("gnss_right is no longer trusted: it is silent" in text for text in texts)
    assert any("GNSS is back" in text for text in texts)
    assert not any("_" in text.replace("gnss_right", "") for text in texts)  # no codes


def test_the_odometry_frame_is_what_lies_between_both_tracks(simulated: Path):
    from scipy.spatial.transform import Rotation

    run = read_run(simulated / "out", None)
    world, odom = (read_tum(simulated / "out" / f"imu_in_{name}.tum") for name in ("world", "odom"))
    for k in (0, len(world.stamps_ns) // 2, -1):
        T = np.eye(4)[None].repeat(2, axis=0)
        for pose, track in zip(T, (world, odom), strict=True):
            pose[:3, :3], pose[:3, 3] = Rotation.from_quat(track.quaternions[k]).as_matrix(), track.positions[k]
        T_W_O = T[0] @ np.linalg.inv(T[1])
        np.testing.assert_allclose(run.correction[k, :3], T_W_O[:3, 3], atol=1e-6)
        yaw = np.degrees(np.arctan2(T_W_O[1, 0], T_W_O[0, 0]))
        assert run.correction[k, 3] == pytest.approx(yaw, abs=1e-6)


def test_reported_deviations_are_those_of_the_published_covariance(simulated: Path):
    run = read_run(simulated / "out", None)
    assert len(run.sigma_times_s) > 100
    assert (run.sigmas["horizontal [m]"] > 0.0).all()
    lost = (run.sigma_times_s > 13.0) & (run.sigma_times_s < 16.0)
    good = (run.sigma_times_s > 5.0) & (run.sigma_times_s < 11.0)
    assert np.median(run.sigmas["horizontal [m]"][lost]) > np.median(run.sigmas["horizontal [m]"][good])


def test_the_page_names_the_command_the_seed_and_the_versions_that_made_it(page, simulated: Path):
    made = page[1]["provenance"]
    replayed, reported = made["command"].split("; ")
    assert replayed == f"holdfast replay {simulated} -c {simulated}/config.yaml -o {simulated}/out"
    assert reported == f"holdfast report {simulated}/out --reference {simulated}/truth"
    assert made["seed"] == "5"
    assert made["versions"]["holdfast"] == version("holdfast")
    assert f"seed 5 · config {made['config_digest']} · holdfast" in page[0]


def test_without_a_reference_there_are_no_errors_but_all_the_rest(simulated: Path, tmp_path: Path):
    call("report", simulated / "out", "-o", tmp_path / "other.html")
    numbers = json.loads((tmp_path / "other.json").read_text(encoding="utf-8"))
    assert "errors" not in numbers["tables"]
    assert {"track", "height-and-speed", "attitude", "nis", "health", "correction", "sigmas", "latencies"} <= set(
        numbers["figures"]
    )


def test_errors_at_held_out_fixes_are_those_of_the_summary(simulated: Path, tmp_path: Path):
    call(
        "replay", simulated, "-c", simulated / "config.yaml", "-o", tmp_path, "--hold-out", "gnss=2", "--duration", "9"
    )
    call("report", tmp_path)
    held_out = json.loads((tmp_path / "summary.json").read_text())["held_out"]["causal"]["all"]
    table = json.loads((tmp_path / "report.json").read_text())["tables"]["held-out"]
    row = dict(zip(table["columns"], table["rows"][0], strict=True))
    assert (row["track"], row["when"]) == ("causal", "all")
    assert row["positions"] == held_out["horizontal_m"]["count"] > 50
    assert row["horizontal RMS [m]"] == pytest.approx(held_out["horizontal_m"]["rms"], rel=1e-6)


def test_sections_have_the_names_that_an_engineer_searches_for(page):
    headings = re.findall(r'<h2 id="s\d">([^<]+)</h2>', page[0])
    assert headings == ["Trajectory", "Accuracy", "Consistency", "Health", "Calibration", "Events", "Timing"]
    assert re.findall(r'<a href="#s\d">([^<]+)</a>', page[0]) == headings


def test_fixes_are_on_the_track_by_what_became_of_them(simulated: Path, tmp_path: Path):
    call("replay", simulated, "-c", simulated / "config.yaml", "-o", tmp_path, "--hold-out", "gnss=4")
    run = read_run(tmp_path, None)
    assert (run.measurements["gnss"].outcomes == "held_out").sum() == 74
    refused = run.measurements["gnss_right"]
    refused.outcomes[np.flatnonzero(refused.outcomes == "used")[:3]] = "innovation"
    (track,) = [block for block in single_run_page(run).sections[0].blocks if getattr(block, "key", "") == "track"]
    drawn = {trace.name: trace for trace in track.plot.data}
    assert {"smoothed", "estimate in O", "estimate, as it was published"} <= set(drawn)
    assert len(drawn["fixes, refused"].x) == 3
    # the antennas of the machine are within three metres of its IMU
    for name in ("fixes, used", "fixes, held out"):
        away = np.hypot(drawn[name].x[:, None] - run.world[:, 0], drawn[name].y[:, None] - run.world[:, 1]).min(axis=1)
        assert len(away) > 30
        assert away.max() < 3.0


def test_innovations_have_their_chi_square_bounds(page):
    rows = {row[0]: row for row in page[1]["tables"]["innovations"]["rows"]}
    assert set(rows) == {"gnss", "gnss_right", "heading"}
    assert rows["gnss"][5] == pytest.approx(7.8147, abs=1e-3)  # chi-square, 3 degrees of freedom, 95 %
    assert rows["heading"][5] == pytest.approx(3.8415, abs=1e-3)
    for name, row in rows.items():
        assert row[1] > 200, name
        assert 0.2 < row[2] < 1.5, name
    names = {trace["name"] for trace in page[1]["figures"]["nis"]["traces"]}
    assert {"used", "95 % bound", "limit of the gate", "without GNSS"} <= names


def test_without_measurements_the_report_says_so_and_has_the_rest(simulated: Path, tmp_path: Path):
    folder = tmp_path / "out"
    shutil.copytree(simulated / "out", folder)
    (folder / "measurements.csv").unlink()
    call("report", folder)
    html = (folder / "report.html").read_text(encoding="utf-8")
    assert "Fixes and innovations are left out" in html
    assert "innovations" not in json.loads((folder / "report.json").read_text())["tables"]


def test_the_page_of_an_hour_is_hardly_larger_than_that_of_a_minute(simulated: Path):
    run = read_run(simulated / "out", simulated / "truth")

    def lasting(seconds: int) -> int:
        times_s = np.arange(seconds * 100) * 0.01
        there = np.column_stack([100.0 * np.sin(times_s / 7.0), times_s, np.cos(times_s)])
        rng = np.random.default_rng(1)
        count = seconds * 20
        fixes = Measurements(
            stamps_ns=run.start_ns + np.arange(count) * 50_000_000,
            outcomes=rng.choice(["used", "innovation", "held_out"], count),
            nis=rng.chisquare(3, count), dof=np.full(count, 3), limit=np.full(count, 64.0),
            positions=rng.normal(size=(count, 3), scale=100.0),
        )  # fmt: skip
        long = replace(
            run, times_s=times_s, world=there, odometry=there, attitude=there, correction=np.tile(there, 2)[:, :4],
            smoothed_times_s=times_s, smoothed=there, sigma_times_s=times_s, speeds=times_s,
            sigmas=dict.fromkeys(run.sigmas, times_s), measurements={"gnss": fixes, "gnss_right": fixes},
        )  # fmt: skip
        return len(render(single_run_page(long)))

    assert lasting(3600) < 1.25 * lasting(120) < 9e6


def test_biases_are_drawn_where_the_diagnostics_have_them(simulated: Path, tmp_path: Path):
    folder = tmp_path / "out"
    shutil.copytree(simulated / "out", folder)
    start_ns = read_run(folder, None).start_ns
    with McapWriter(folder / "estimates.mcap") as writer:
        types = writer.types
        for k in range(3):
            stamp_ns = start_ns + k * 10**9
            values = [
                types["diagnostic_msgs/msg/KeyValue"](key=key, value=f"{i + k}") for i, key in enumerate(BIAS_KEYS)
            ]
            status = types["diagnostic_msgs/msg/DiagnosticStatus"](
                level=0, name="holdfast", message="", hardware_id="", values=values
            )
            stamp = types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
            array = types["diagnostic_msgs/msg/DiagnosticArray"](header=header, status=[status])
            writer.write("/diagnostics", array, "diagnostic_msgs/msg/DiagnosticArray", stamp_ns)
    run = read_run(folder, simulated / "truth")
    np.testing.assert_allclose(run.bias_times_s, [0.0, 1.0, 2.0], atol=1e-6)
    np.testing.assert_allclose(run.biases, np.arange(6)[None] + np.arange(3)[:, None])
    table = np.genfromtxt(simulated / "truth" / "imu_bias.csv", delimiter=",", names=True)
    assert run.true_biases is not None
    np.testing.assert_array_equal(run.true_biases[:, 0], table["gyroscope_x_rad_s"])
    np.testing.assert_array_equal(run.true_biases[:, 5], table["accelerometer_z_m_s2"])
    assert "biases" in {block.key for section in single_run_page(run).sections for block in section.blocks}


def test_a_replay_that_was_cut_off_still_has_a_report(simulated: Path, tmp_path: Path):
    folder = tmp_path / "out"
    shutil.copytree(simulated / "out", folder)
    (folder / "estimates.mcap").write_bytes(b"")
    events = (folder / "events.jsonl").read_bytes()
    (folder / "events.jsonl").write_bytes(events[:-20])
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps(summary | {"finished": False}))
    call("report", folder)
    numbers = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert "did not come to its end" in numbers["lead"]
    assert "are left out" in (folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("file", "content", "error", "words"),
    [
        ("summary.json", None, ConfigError, "holdfast replay"),
        ("summary.json", "{", RecordingError, "no summary"),
        ("summary.json", "{}", RecordingError, "'recording'"),
        ("events.jsonl", "nothing\n{}\n", RecordingError, "events.jsonl:1"),
        ("imu_in_world.tum", "", RecordingError, "no poses"),
    ],
)
def test_what_is_no_replay_is_named_by_file(simulated: Path, tmp_path: Path, file, content, error, words):  # noqa: PLR0917
    folder = tmp_path / "out"
    shutil.copytree(simulated / "out", folder)
    (folder / file).unlink() if content is None else (folder / file).write_text(content)
    with pytest.raises(error, match=words) as caught:
        call("report", folder)
    assert file in str(caught.value)


def test_a_reference_of_another_time_and_a_wrong_name_are_refused(simulated: Path, tmp_path: Path):
    (tmp_path / "other.tum").write_text("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n")
    with pytest.raises(RecordingError, match=r"other\.tum: no overlap in time"):
        call("report", simulated / "out", "--reference", tmp_path / "other.tum")
    with pytest.raises(RecordingError, match=r"none\.tum: no such file"):
        call("report", simulated / "out", "--reference", tmp_path / "none.tum")
    with pytest.raises(RecordingError, match=r"holds no truth .allowed: a TUM file, or the truth/ folder of a simul"):
        call("report", simulated / "out", "--reference", tmp_path)
    with pytest.raises(RecordingError, match=rf"; is {simulated / 'truth'} meant\?$"):
        call("report", simulated / "out", "--reference", simulated)
    with pytest.raises(HoldfastError, match=r"must end in \.html"):
        call("report", simulated / "out", "-o", tmp_path / "report.pdf")


RANGES = (
    "Array.from(document.querySelectorAll('.plot')).filter((box) => box.layout.meta.over_time)"
    ".map((box) => box.layout.xaxis.range)"
)


@needs_chromium
def test_plots_over_time_follow_each_other_and_a_click_on_an_event(page, simulated: Path, tmp_path: Path):
    with BrowserPage(simulated / "out" / "report.html", tmp_path, (1400, 900, False), "dark") as opened:
        opened.wait_until_drawn(len(page[1]["figures"]))
        first = "document.querySelector('#attitude .plot')"
        opened.value_of(f"Plotly.relayout({first}, {{'xaxis.range[0]': 5, 'xaxis.range[1]': 9}})")
        ranges = opened.value_of(RANGES)
        assert len(ranges) >= 8
        assert all(one == [5, 9] for one in ranges)
        assert opened.value_of(f"{first}.layout.xaxis.ticktext[0]") == "5.0<br>12:26:45.0"
        rows = page[1]["tables"]["switches"]["rows"]
        chosen = next(k for k, row in enumerate(rows) if "GNSS is lost" in row[2])
        at_s = float(rows[chosen][0])
        opened.value_of(f"document.querySelectorAll('tr[data-time]')[{chosen}].click()")
        assert all(low < at_s < high for low, high in opened.value_of(RANGES))
        marked = opened.value_of(f"{first}.layout.shapes.at(-1).x0")
        assert marked == pytest.approx(at_s, abs=0.01)
        run = read_run(simulated / "out", None)
        there = run.world[np.searchsorted(run.times_s, at_s)]
        cross = opened.value_of("(({x, y}) => [x[0], y[0]])(document.querySelector('#track .plot').data.at(-1))")
        assert np.hypot(*(there[:2] - cross)) < 0.02
        opened.value_of("document.getElementById('all').click()")
        assert all(one == opened.value_of(RANGES)[0] for one in opened.value_of(RANGES))
        assert opened.value_of(RANGES)[0][0] == 0
        assert opened.value_of(f"{first}.layout.paper_bgcolor") == "#12181f"
        assert opened.errors == []
        # the contents stay in sight
        opened.value_of("window.scrollTo(0, 5000)")
        assert 0 <= opened.value_of("document.querySelector('nav').getBoundingClientRect().top") < 100


@needs_chromium
@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=["phone", "desktop"])
def test_a_browser_draws_the_whole_report(page, simulated: Path, tmp_path: Path, size):
    assert len(page[1]["figures"]) >= 8
    check_page(simulated / "out" / "report.html", tmp_path, size, len(page[1]["figures"]))


def test_a_reference_about_another_datum_is_judged_by_in_the_world_of_the_run(simulated: Path, tmp_path: Path):
    as_given = read_run(simulated / "out", simulated / "truth")
    assert as_given.errors is not None
    lines = (simulated / "config.yaml").read_text(encoding="utf-8")
    without = re.sub(r"\n  datum:\n(    .*\n)+", "\n", lines)
    assert without != lines
    (tmp_path / "config.yaml").write_text(without, encoding="utf-8")
    call("replay", simulated, "-c", tmp_path / "config.yaml", "-o", tmp_path / "out")
    run = read_run(tmp_path / "out", simulated / "truth")
    assert run.summary["datum"] != as_given.summary["datum"]
    assert any("datum" in note and "m from that of the run" in note for note in run.notes)
    assert run.errors is not None
    for name in ("horizontal [m]", "vertical [m]"):
        ours, given = (np.sqrt(np.mean(one.errors.values[name] ** 2)) for one in (run, as_given))
        assert ours < given + 0.05  # the machine is metres from where the first fix put the origin
    judged = call("evaluate", tmp_path / "out" / "imu_in_world.tum", simulated / "truth" / "imu_in_world.tum")
    assert "m from that of the run" in judged

"""A folder of results is replaced as a whole, and nothing that somebody else wrote is touched."""

import multiprocessing
import os
from pathlib import Path

import pytest

from holdfast.errors import ConfigError
from holdfast.output_folder import MARK, add_results, check_output_file, continued, replaced

RESULT = "x" * 5000  # more than headers


def write(folder: Path, *names: str, text: str = RESULT, **options: object) -> None:
    with replaced(folder, "replay", **options):
        for name in names:
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text)


def names(folder: Path) -> set[str]:
    return {file.name for file in folder.iterdir()} - {MARK}


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "parent" / "out"


def test_no_file_of_an_earlier_run_remains(out):
    write(out, "a.tum", "truth/b.tum")
    write(out, "c.tum")
    assert names(out) == {"c.tum"}
    assert names(out.parent) == {"out"}


def test_the_results_of_a_run_that_fails_replace_the_earlier_ones(out):
    write(out, "a.tum", "b.tum")
    with pytest.raises(ZeroDivisionError), replaced(out, "replay"):
        (out / "a.tum").write_text("new" + RESULT)
        raise ZeroDivisionError
    assert names(out) == {"a.tum"}
    assert (out / "a.tum").read_text().startswith("new")


def test_earlier_results_come_back_if_a_run_fails_before_it_has_any(out):
    write(out, "a.tum", "b.tum")
    with pytest.raises(ZeroDivisionError), replaced(out, "replay"):
        (out / "c.tum").write_text("header")
        raise ZeroDivisionError
    assert names(out) == {"a.tum", "b.tum"}
    assert names(out.parent) == {"out"}


def test_an_interrupt_names_the_folder(out):
    with pytest.raises(KeyboardInterrupt, match=f"what was done until then is in {out}"), replaced(out, "replay"):
        (out / "a.tum").write_text(RESULT)
        raise KeyboardInterrupt


@pytest.mark.parametrize("is_there", [False, True])
def test_a_run_that_ends_before_it_has_any_result_leaves_nothing(out, is_there):
    """Ctrl-C while the recording was being opened left a folder of headers without a summary."""
    out.parent.mkdir()
    if is_there:
        out.mkdir()
    with pytest.raises(KeyboardInterrupt, match=r"^nothing was done yet$"), replaced(out, "replay"):
        (out / "a.tum").write_text("header")
        (out / "causal").mkdir()
        raise KeyboardInterrupt
    assert [one.name for one in out.parent.rglob("*")] == ["out"] * is_there


def test_what_holdfast_did_not_write_is_named_and_kept(out):
    write(out, "a.tum")
    (out / "notes.txt").write_text("mine")
    with pytest.raises(ConfigError, match=r"out: holds what Holdfast did not write \(notes.txt\): give another folder"):
        write(out, "b.tum")
    assert names(out) == {"a.tum", "notes.txt"}
    for strange in ("b", "c", "d"):
        (out / strange).touch()
    with pytest.raises(ConfigError, match=r"\(b, c, d, \.\.\.\)"):
        write(out, "b.tum")


def test_results_that_were_added_are_replaced_too(out):
    write(out, "a.tum")
    (out / "report.html").touch()
    add_results(out / "report.html")
    write(out, "c.tum")
    assert names(out) == {"c.tum"}


@pytest.mark.parametrize("of", ["replay", "simulate"])
def test_results_of_another_run_within_are_refused_and_kept(out, of):
    """A replay into a folder deleted the replay into a folder within it, without a word."""
    with replaced(out, of):
        (out / "a.tum").write_text(RESULT)
    write(out.parent / "variant", "b.tum")
    (out.parent / "variant").rename(out / "variant")
    with (
        pytest.raises(ConfigError, match=r"out: holds results of other runs \(variant\): give another folder$"),
        replaced(out, of),
    ):
        pass
    assert names(out) == {"a.tum", "variant"}
    with pytest.raises(ConfigError, match=r"parent: holds results of other runs \(out\)|is a simulated|simulated rec"):
        write(out.parent, "c.tum")
    assert names(out / "variant") == {"b.tum"}


@pytest.mark.parametrize("command", ["batch", "paper", "ablate"])
def test_a_folder_of_several_runs_is_replaced_by_its_own_command_only(out, command):
    """`holdfast replay -o` deleted the table of a batch and all its runs."""
    with continued(out, command):
        write(out / "run", "a.tum")
    with pytest.raises(ConfigError, match=f"out: holds results of holdfast {command}: give another folder, or remove"):
        write(out, "b.tum")
    assert names(out) == {"run"}
    with replaced(out, command):
        (out / "c.tum").write_text(RESULT)
    assert names(out) == {"c.tum"}


def test_a_run_that_was_killed_leaves_its_files_only_and_the_next_one_replaces_them(out):
    write(out, "a.tum")
    killed = multiprocessing.get_context("fork").Process(target=write_and_die, args=(out,))
    killed.start()
    killed.join()
    assert killed.exitcode == 9
    assert names(out) == {"b.tum"}
    write(out, "c.tum")
    assert names(out) == {"c.tum"}
    assert names(out.parent) == {"out"}


def write_and_die(out: Path) -> None:
    with replaced(out, "replay"):
        (out / "b.tum").write_text("half")
        os._exit(9)


def test_a_folder_that_another_process_writes_is_refused(out):
    with replaced(out, "replay"):
        (out / "a.tum").write_text(RESULT)
        with pytest.raises(ConfigError, match="is being written by another process"):
            write(out, "b.tum")
    assert names(out) == {"a.tum"}


def test_an_output_folder_that_is_a_link_stays_one(out, tmp_path):
    write(out, "a.tum")
    link = tmp_path / "link"
    link.symlink_to(out)
    write(link, "b.tum")
    assert link.is_symlink()
    assert names(out) == {"b.tum"}


def test_the_folder_in_which_one_is_can_be_replaced(out, monkeypatch):
    write(out, "a.tum", "truth/b.tum")
    monkeypatch.chdir(out)
    with replaced(".", "replay"):
        Path("c.tum").write_text(RESULT)
    assert names(Path()) == {"c.tum"}


def test_a_folder_that_goes_on_keeps_its_results_and_refuses_what_is_strange(out):
    for name in ("a", "b"):
        with continued(out, "batch"):
            (out / name).touch()
    assert names(out) == {"a", "b"}
    (out / "mine").touch()
    with pytest.raises(ConfigError, match="did not write"), continued(out, "batch"):
        pass


@pytest.mark.parametrize("command", ["batch", "paper"])
def test_results_of_one_command_are_never_mixed_with_those_of_another(out, command):
    write(out, "a.tum")
    with pytest.raises(ConfigError, match="holds results of holdfast replay"), continued(out, command):
        pass
    assert names(out) == {"a.tum"}
    with replaced(out, "demo"):
        (out / "b.tum").write_text(RESULT)
    assert names(out) == {"b.tum"}


@pytest.mark.parametrize("output", ["bag", "bag/out", "bag/deeper/out", "bag/bag_0.mcap", "csv", "csv/out", "."])
def test_nothing_is_written_into_a_recording(tmp_path, output, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for file in ("bag/bag_0.mcap", "csv/imu.csv"):
        Path(file).parent.mkdir()
        Path(file).write_text("measured")
    Path("bag/metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    reads = ["bag/bag_0.mcap" if output.startswith("bag") else "csv"]
    with pytest.raises(ConfigError, match=r"give an|must be a folder"):
        write(Path(output), "a.tum", reads=reads)
    assert names(tmp_path) == {"bag", "csv"}
    assert names(Path("bag")) == {"bag_0.mcap", "metadata.yaml"}


@pytest.mark.parametrize("output", ["bag/bag_0.mcap", "bag/new.mcap", "csv/imu.csv", "csv/new.csv"])
def test_no_file_is_written_into_a_recording_that_is_read(tmp_path, output):
    for file in ("bag/bag_0.mcap", "csv/imu.csv"):
        (tmp_path / file).parent.mkdir()
        (tmp_path / file).touch()
    with pytest.raises(ConfigError, match="give an"):
        check_output_file(tmp_path / output, [tmp_path / "bag", tmp_path / "csv"])
    check_output_file(tmp_path / "new.csv", [tmp_path / "bag", tmp_path / "csv"])


def test_results_may_stand_in_the_folder_of_a_simulation_but_not_take_its_place(tmp_path):
    site = tmp_path / "site"
    with replaced(site, "simulate"):
        (site / "recording.mcap").touch()
    write(site / "out", "a.tum", reads=[site])
    with pytest.raises(ConfigError, match=r"site: is or holds .*, which is read: give another output"):
        write(site, "a.tum", reads=[site / "recording.mcap"])


def test_a_simulation_does_not_go_into_the_folder_of_another_one(tmp_path):
    """The next simulation into the outer folder was refused because of it."""
    site = tmp_path / "site"
    with replaced(site, "simulate"):
        (site / "recording.mcap").touch()
    with (
        pytest.raises(ConfigError, match=r"again: is in .*site, the results of holdfast simulate: give another folder"),
        replaced(site / "deep" / "again", "simulate"),
    ):
        pass
    assert names(site) == {"recording.mcap"}


def test_a_simulated_recording_is_replaced_by_another_one_only(tmp_path):
    """`holdfast demo -o` deleted a recording, and a replay into the folder above all of them."""
    site = tmp_path / "sites" / "quarry"
    for name in ("a.mcap", "b.mcap"):
        with replaced(site, "simulate"):
            (site / name).write_text(RESULT)
    assert names(site) == {"b.mcap"}
    with pytest.raises(ConfigError, match="quarry: is a simulated recording"):
        write(site, "a.tum")
    with pytest.raises(ConfigError, match=r"sites: holds simulated recordings \(quarry\)"):
        write(site.parent, "a.tum")
    assert names(site) == {"b.mcap"}


def test_the_configuration_that_is_read_is_never_replaced(out):
    write(out, "config.yaml")
    with pytest.raises(ConfigError, match=r"is or holds .*config.yaml, which is read"):
        write(out, "a.tum", reads=[out / "config.yaml"])
    with pytest.raises(ConfigError, match="which is read"):
        check_output_file(out / "config.yaml", [out / "config.yaml"])


@pytest.mark.parametrize("name", ["a.tum", "truth/imu_bias.csv", MARK])
def test_no_file_of_a_run_is_overwritten_by_another_command(out, name):
    """`holdfast export -o OUT/measurements.csv` and `evaluate --json OUT/summary.json` did so."""
    write(out, "a.tum", "truth/imu_bias.csv")
    with pytest.raises(ConfigError, match=f"{name}: was written by holdfast replay, which keeps it: give another file"):
        check_output_file(out / name)


@pytest.mark.parametrize("name", ["track.csv", "truth/track.csv", "mine/track.csv"])
def test_a_file_beside_the_results_is_new_once_and_then_written_again(out, name):
    write(out, "a.tum", "truth/imu_bias.csv")
    (out / "mine").mkdir()
    for _ in range(2):
        check_output_file(out / name)
        (out / name).touch()
        add_results(out / name)


def test_what_was_added_to_a_folder_that_goes_on_may_be_written_again(out):
    with continued(out, "paper"):
        (out / "results.json").touch()
    (out / "report.html").touch()
    add_results(out / "report.html")
    with continued(out, "paper"):
        pass
    check_output_file(out / "report.html")
    with pytest.raises(ConfigError, match="was written by holdfast paper"):
        check_output_file(out / "results.json")


@pytest.mark.parametrize(("file", "why"), [
    ("nowhere/track.csv", "its folder does not"), ("out", "it is a folder"), ("out/a.tum/b.csv", "its folder does not"),
])  # fmt: skip
def test_a_file_that_cannot_be_written_is_named_before_the_work(out, file, why):
    write(out, "a.tum")
    with pytest.raises(ConfigError, match=rf"{file}: cannot be written \({why}"):
        check_output_file(out.parent / file)


def test_results_do_not_go_into_those_of_another_run(out):
    """The next run into the outer folder was refused because of them."""
    write(out, "a.tum")
    with pytest.raises(ConfigError, match=r"is in .*out, the results of holdfast replay: give another folder"):
        write(out / "deep" / "again", "b.tum")
    assert names(out) == {"a.tum"}


def test_an_interrupt_before_there_is_any_result_tells_that_those_of_before_are_there(out):
    """It told of what had been done, and the results of before were taken for that."""
    write(out, "a.tum")
    untouched = pytest.raises(KeyboardInterrupt, match=r"^nothing was done yet, .*out holds the results of before$")
    with untouched, replaced(out, "replay"):
        raise KeyboardInterrupt
    done = pytest.raises(KeyboardInterrupt, match=r"^what was done until then is in .*out$")
    with done, replaced(out, "replay"):
        (out / "b.tum").write_text(RESULT)
        raise KeyboardInterrupt
    assert names(out) == {"b.tum"}

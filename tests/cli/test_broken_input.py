"""Every kind of broken input that we could think of, through the command line: one clear line and the right exit code.

The commands run in this process, where an exception that is not meant for the user fails the test.
"""

import json
import os
import shlex
import shutil
import sys
from pathlib import Path

import pytest

sys.path += [str(Path(__file__).parents[1] / room) for room in ("replay", "recording")]

from bags import write_bag
from small_drive import bag_messages, holdfast, make_rows, write_config, write_csv

ROWS = make_rows(seconds=1.6)
LONGEST_LINE = 1000  # an error quotes no more of the input than that
POSE = "1700000000.5 1 2 3 0 0 0 1\n"


def make_sound(folder):
    """Make a folder with a CSV drive, a bag, a configuration, and a trajectory."""
    folder.mkdir()
    write_csv(folder / "csv", ROWS)
    write_bag(folder / "bag", "mcap", bag_messages(ROWS))
    shutil.copy(next((folder / "bag").glob("*.mcap")), folder / "drive.mcap")
    write_config(folder / "machine.yaml")
    (folder / "a.tum").write_text("".join(f"{k}.5 {k} 0 0 0 0 0 1\n" for k in range(5)))
    return folder


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return make_sound(tmp_path_factory.mktemp("place") / "sound")


@pytest.fixture
def place(sound, tmp_path, monkeypatch):
    """A copy of it, in which the commands run."""
    shutil.copytree(sound, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def cell(line, column, text, file="csv/imu.csv"):
    """Put a text into a cell of a CSV file."""

    def change():
        lines = Path(file).read_text().splitlines(keepends=True)
        cells = lines[line].rstrip("\n").split(",")
        cells[column] = text
        lines[line] = ",".join(cells) + "\n"
        Path(file).write_text("".join(lines))

    return change


def content(file, data):
    """Give a file another content."""
    return lambda: Path(file).write_bytes(data if isinstance(data, bytes) else data.encode())


def cut(file, share):
    return lambda: os.truncate(file, int(Path(file).stat().st_size * share))


def recoded(file, change):
    return lambda: Path(file).write_bytes(change(Path(file).read_text()))


def folder(path):
    def change():
        Path(path).unlink(missing_ok=True)
        Path(path).mkdir()

    return change


def later(file, by_ns):
    """Move the stamps of a CSV file and their arrivals."""

    def change():
        head, *rows = Path(file).read_text().splitlines()
        moved = [[str(int(cell) + by_ns) for cell in row.split(",")[:2]] + row.split(",")[2:] for row in rows]
        Path(file).write_text("\n".join([head, *map(",".join, moved)]) + "\n")

    return change


def all_later(seconds):
    return lambda: [later(f"csv/{name}.csv", seconds * 10**9)() for name in ("imu", "gnss", "lidar")]


def a_run(*files):
    """Make a folder of results."""

    def change():
        Path("out").mkdir()
        Path("out/.holdfast").write_text(json.dumps({"command": "replay", "files": files}))
        for file in files:
            Path("out", file).touch()

    return change


def nothing():
    """Break nothing: the command itself is wrong."""


def holes(file):
    def change():
        data = bytearray(Path(file).read_bytes())
        data[1000::997] = bytes(byte ^ 0xFF for byte in data[1000::997])
        Path(file).write_bytes(data)

    return change


TO, VERDICT = "replay csv -c machine.yaml -o", "evaluate a.tum a.tum"
CSV, BAG = f"{TO} out", "replay drive.mcap -c machine.yaml -o out"
CASES = {
    # --- recordings: cells of a CSV file
    "a stamp of 40 digits": (cell(50, 0, "1" * 40), CSV, 3, "imu.csv:51: column stamp_ns is"),
    "a first stamp of 40 digits": (cell(1, 0, "1" * 40), CSV, 3, "imu.csv:2: column stamp_ns is"),
    "a last stamp of 40 digits": (cell(-1, 0, "1" * 40), CSV, 3, "imu.csv:161: column stamp_ns is"),
    "an arrival of 40 digits": (cell(50, 1, "9" * 40), CSV, 3, "imu.csv:51: column arrival_ns is"),
    "a stamp of 5000 digits": (cell(50, 0, "1" * 5000), CSV, 3, "imu.csv:51: column stamp_ns is"),
    "info of a stamp of 40 digits": (cell(50, 0, "1" * 40), "info csv", 3, "imu.csv:51: column stamp_ns is"),
    "a stamp as a float": (cell(50, 0, "1.7e18"), CSV, 3, "imu.csv:51: column stamp_ns is '1.7e18'"),
    "a word of a megabyte": (cell(50, 3, "x" * 1_000_000), CSV, 3, "imu.csv:51: column wy_rad_s is"),
    "a column too many": (cell(50, 3, "0,0"), CSV, 3, "imu.csv:51: has 9 columns"),
    "bytes that are no text": (recoded("csv/imu.csv", lambda t: t.encode()[:999] + b"\xff\n"), CSV, 3, "imu.csv:"),
    # --- recordings: files
    "an IMU file of binary rubbish": (content("csv/imu.csv", bytes(range(256)) * 40), CSV, 3, "imu.csv:1"),
    "an IMU file of zeros": (content("csv/imu.csv", bytes(9999)), CSV, 3, "imu.csv:1"),
    "an IMU file in UTF-16": (recoded("csv/imu.csv", lambda t: t.encode("utf-16")), CSV, 3, "imu.csv:1"),
    "semicolons": (recoded("csv/imu.csv", lambda t: t.replace(",", ";").encode()), CSV, 3, "imu.csv:1"),
    "a folder named imu.csv": (folder("csv/imu.csv"), CSV, 3, "imu.csv: cannot be opened (Is a directory)"),
    "a header of a megabyte": (content("csv/imu.csv", "a," * 500_000), CSV, 3, "imu.csv:1"),
    "an IMU file that is empty": (content("csv/imu.csv", ""), CSV, 3, "has no topic 'imu'"),
    "nothing in any file": (lambda: [content(f, "")() for f in Path("csv").iterdir()], CSV, 3, "holds no recording"),
    "an empty folder": (folder("none"), "replay none -c machine.yaml -o out", 3, "none: the folder holds no recording"),
    "no file": (nothing, "replay none.mcap -c machine.yaml -o out", 3, "none.mcap: no such file"),
    "a name of 300 letters": (nothing, f"replay {'x' * 300} -c machine.yaml -o out", 3, "File name too long"),
    "a bag cut in its first chunk": (cut("drive.mcap", 0.3), BAG, 3, "drive.mcap: holds no messages"),
    "a bag of 20 bytes": (lambda: os.truncate("drive.mcap", 20), BAG, 3, "drive.mcap: holds no messages"),
    "an empty bag": (content("drive.mcap", ""), BAG, 3, "drive.mcap: the file is empty"),
    "a bag of zeros": (content("drive.mcap", bytes(9999)), BAG, 3, "drive.mcap: is no MCAP file"),
    "a bag full of holes": (holes("drive.mcap"), BAG, 3, "drive.mcap: "),
    "a folder named like a bag": (folder("drive.mcap"), BAG, 3, "drive.mcap: the folder holds no recording"),
    "a text as a database": (content("x.db3", "hello" * 99), "info x.db3", 3, "x.db3: cannot be opened"),
    "a text as a ROS 1 bag": (content("x.bag", "hello" * 99), "info x.bag", 3, "x.bag: cannot be opened"),
    "the null device": (nothing, "replay /dev/null -c machine.yaml -o out", 3, "/dev/null: "),
    "binary metadata and no bag": (content("csv/metadata.yaml", b"\xff\xfe"), CSV, 3, "metadata.yaml: is damaged"),
    "metadata of a bag that is gone": (
        lambda: [file.unlink() for file in Path("bag").glob("*.mcap")],
        "replay bag -c machine.yaml -o out", 3, "names files that are missing",
    ),
    "an IMU without a sample": (cut("csv/imu.csv", 0.004), CSV, 3, "imu.csv"),
    # --- configurations
    "a configuration of rubbish": (content("machine.yaml", b"\xff\xfe\x00" * 99), CSV, 2, "machine.yaml: is not UTF-8"),
    "an empty configuration": (content("machine.yaml", ""), CSV, 2, "machine.yaml:1 is empty"),
    "a list": (content("machine.yaml", "- a\n"), CSV, 2, "machine.yaml:1 has a list at the top"),
    "a tab": (content("machine.yaml", "sensors:\n\timu: 3\n"), CSV, 2, "machine.yaml:2:1 is not YAML"),
    "a zero byte": (content("machine.yaml", "a: \0"), CSV, 2, "machine.yaml:1 is not YAML"),
    "an alias of itself": (content("machine.yaml", "a: &a [*a]\n"), CSV, 2, "machine.yaml:1 "),
    "a number of 500 digits": (recoded("machine.yaml", lambda t: t.replace("9.81", "9" * 500).encode()), CSV, 2, ":"),
    "a folder for a file": (folder("machine.yaml"), CSV, 2, "machine.yaml: is a folder"),
    "no configuration": (Path("machine.yaml").unlink, CSV, 2, "machine.yaml: no such file"),
    "the recording as its configuration": (nothing, "replay csv -c drive.mcap -o out", 2, "drive.mcap: is not UTF-8"),
    # --- outputs
    "an output in a file": (nothing, f"{TO} a.tum/out", 2, "cannot be written (Not a directory)"),
    "an output that is a file": (nothing, f"{TO} a.tum", 2, "must be a folder"),
    "an output where nothing can be": (nothing, f"{TO} /proc/out", 2, "/proc/out: cannot be"),
    "an output on a device": (nothing, f"{TO} /dev/null", 2, "/dev/null: is a file"),
    "an output of 300 letters": (nothing, f"replay csv -c machine.yaml -o {'x' * 300}", 2, "File name too long"),
    "an output that is a loop": (lambda: Path("o").symlink_to("o"), f"{TO} o", 2, "o: cannot be"),
    "an output with other files": (nothing, f"{TO} .", 2, "which is read"),
    "a simulation over a recording": (nothing, "simulate quick --duration 2 -o csv", 2, "did not write (gnss.csv, "),
    "a batch over a recording": (nothing, "batch csv -c machine.yaml -o csv", 2, "csv: is or holds csv, which is read"),
    "a batch in a recording": (nothing, "batch csv -c machine.yaml -o csv/out", 2, "csv/out: is in the recording csv"),
    "a report over its reference": (
        folder("out"), "report out --reference a.tum -o a.tum", 2, "a.tum: the name must end in .html",
    ),
    "a verdict over what it judges": (nothing, f"{VERDICT} --json a.tum", 2, "a.tum, which is read"),
    "a verdict in no folder": (nothing, f"{VERDICT} --json none/v.json", 2, "none/v.json: cannot be written"),
    "a configuration over the bag": (nothing, "config init drive.mcap -o drive.mcap --force", 2, "which is read"),
    # --- options
    "an endless duration": (nothing, f"{CSV} --duration inf", 2, "--duration inf: must be"),
    "a start at infinity": (nothing, f"{CSV} --start inf", 2, "--start inf: must be"),
    "a duration beyond all times": (nothing, f"{CSV} --duration 1e300", 2, "--duration 1e+300: must be"),
    "an outage at no time": (nothing, f"{CSV} --outage gnss=nan:nan", 2, "--outage gnss=nan:nan: must"),
    "every second sample of what gives no position": (
        nothing, f"{CSV} --hold-out imu=2", 2, "--hold-out imu=2: imu gives no positions, by which an estimate is",
    ),
    "results in those of another run": (
        a_run("a.tum"), f"{TO} out/again", 2, "out/again: is in ", ),
    "a rate of nearly nothing": (nothing, f"{CSV} --rate 1e-320", 2, "--rate 9.99989e-321: must be"),
    "info from infinity": (nothing, "info csv --start inf", 2, "--start inf: must be"),
    "a bench without end": (nothing, "bench --duration inf", 2, "--duration inf: must be"),
    "a scenario of rubbish": (content("s.yaml", b"\xff"), "simulate s.yaml -o out", 2, "s.yaml: is not UTF-8"),
    "no scenario": (nothing, "simulate none.yaml -o out", 2, "none.yaml"),
    "a variation of nothing": (nothing, "batch csv -c machine.yaml -o out --vary a", 2, "--vary a: expected"),
    "a variation of a list": (nothing, "batch csv -c machine.yaml -o out --vary sensors=[", 2, "--vary"),
    "a recording twice": (nothing, "batch csv csv -c machine.yaml -o out", 2, "csv: two runs"),
    "lidar odometry of a CSV folder": (nothing, "lidar-odometry csv -o out.mcap", 3, "csv"),
    "lidar odometry without clouds": (nothing, "lidar-odometry drive.mcap -o out.mcap", 3, "PointCloud2"),
    "lidar odometry over its input": (nothing, "lidar-odometry drive.mcap -o drive.mcap --force", 2, "which is read"),
    "a variable of the shell that is not set": (nothing, "replay '' -o out", 2, "an argument is empty: is a variable"),
    "a latency that is no number": (
        nothing, "lidar-odometry drive.mcap -o out.mcap --latency-s nan", 2, "nan is not a finite number",
    ),
    "a range that is no number": (nothing, "map out drive.mcap --min-range nan", 2, "nan is not a finite number"),
    "a calibration from one recording twice": (
        nothing, "calibrate csv ./csv -c machine.yaml -o out.yaml", 2, "csv: is given twice, and would count twice",
    ),
    "a view over what a run wrote": (
        a_run("scene.rrd"), "view drive.mcap -o out/scene.rrd", 2, "out/scene.rrd: was written by holdfast replay",
    ),
    "a view into no folder": (nothing, "view drive.mcap -o no/s.rrd", 2, "no/s.rrd: cannot be written (its folder"),
    "a view into its recording": (nothing, "view bag -o bag/s.rrd", 2, "bag/s.rrd: is in the recording bag"),
    "a bench over its recording": (
        nothing, "bench --recording drive.mcap -c machine.yaml --json drive.mcap", 2, "drive.mcap: is or holds drive",
    ),
    "a bench over what a run wrote": (
        a_run("summary.json"), "bench --json out/summary.json", 2, "out/summary.json: was written by holdfast replay",
    ),
    "a bench in real time into a folder": (nothing, "bench realtime --json csv", 2, "csv: cannot be written (it is a"),
    "what was learnt into no folder": (nothing, f"{CSV} --learnt no/l.json", 2, "no/l.json: cannot be written (its"),
    "a configuration into no folder": (nothing, "config init csv -o no/c.yaml", 2, "no/c.yaml: cannot be written (its"),
    "a view of a text": (nothing, "view a.tum -o out.rrd", 3, "a.tum: "),
    "an upgrade of rubbish": (nothing, "config upgrade drive.mcap", 2, "drive.mcap: is not UTF-8"),
    "a check of a folder": (nothing, "config check csv", 2, "csv: is a folder"),
    "a simulation without end": (nothing, "simulate quick --duration inf -o out", 2, "--duration inf: must be"),
    "a simulation of 30,000 years": (
        nothing, "simulate quick --duration 1e12 -o out", 2, "--duration 1e+12: must be > 1 and <= 36000",
    ),
    # --- trajectories
    "a trajectory with a stamp of 1e999999999": (
        content("b.tum", POSE + "1e999999999 1 2 3 0 0 0 1\n"), "evaluate b.tum a.tum", 3, "b.tum:2: has a number",
    ),
    "a trajectory of rubbish": (content("b.tum", bytes(range(256))), "evaluate b.tum a.tum", 3, "b.tum:"),
    "a trajectory with NaN": (content("b.tum", "nan 1 2 3 0 0 0 1\n"), "evaluate b.tum a.tum", 3, "b.tum:1: "),
    "an empty trajectory": (content("b.tum", ""), "evaluate b.tum a.tum", 3, "b.tum: holds no poses"),
    "a folder as a trajectory": (folder("b.tum"), "evaluate b.tum a.tum", 2, "b.tum"),
    "a distance of nothing": (nothing, f"{VERDICT} --rpe-distance 0", 2, "--rpe-distance 0: must be > 0 and finite"),
    "a distance that is no number": (nothing, f"{VERDICT} --rpe-distance nan", 2, "--rpe-distance nan: must be > 0"),
    "a time without end": (nothing, f"{VERDICT} --rpe-time inf", 2, "--rpe-time inf: must be > 0 and finite"),
    "a gap that is no number": (nothing, f"{VERDICT} --max-gap-s nan", 2, "--max-gap-s nan: must be"),
    "an offset without end": (nothing, f"{VERDICT} --reference-offset-s inf", 2, "--reference-offset-s inf: must be"),
    "an offset beyond all times": (
        nothing, f"{VERDICT} --reference-offset-s 1e300", 2, "--reference-offset-s 1e+300: must be finite",
    ),
    "a lever arm that is no number": (
        nothing, f"{VERDICT} --reference-lever-arm nan 0 0", 2, "--reference-lever-arm nan 0 0: must be finite",
    ),
    "an interval at no time": (nothing, f"{VERDICT} --interval a=nan:nan", 2, "a=nan:nan: interval 'a': its start nan"),
    "an interval without end": (
        nothing, f"{VERDICT} --interval a=0:inf", 2, "--interval a=0:inf: interval 'a': its start 0.0 s must be before",
    ),
    "an interval without a name": (nothing, f"{VERDICT} --interval =0:1", 2, "--interval =0:1: interval '': give it"),
    "intervals of rubbish": (
        content("i.yaml", b"\xff\xfe"), f"{VERDICT} --intervals i.yaml", 2, "--intervals i.yaml: ",
    ),
    "no intervals": (
        content("i.yaml", ""), f"{VERDICT} --intervals i.yaml", 2, "i.yaml:1 is empty: must be `key: value` lines",
    ),
    "intervals that are nested deeply": (
        content("i.yaml", "a: " + "[" * 4000), f"{VERDICT} --intervals i.yaml", 2, "--intervals i.yaml:1 is nested too",
    ),
    "a variation that is nested deeply": (
        nothing, f"batch csv -c machine.yaml -o out --vary graph.lag_s={'[' * 4000}", 2, "is no YAML value",
    ),
    # --- results
    "a report about nothing": (folder("out"), "report out", 2, "out/summary.json: no such file"),
    "a summary of rubbish": (
        lambda: (folder("out")(), content("out/summary.json", b"\xff{")()), "report out", 3, "is no summary of",
    ),
    "a list as a summary": (
        lambda: (folder("out")(), content("out/summary.json", "[1]")()), "report out", 3, "is no summary of a replay",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_broken_input_gets_one_clear_line_and_its_exit_code(name, place):
    break_it, command, code, words = CASES[name]
    break_it()
    done = holdfast(*shlex.split(command))
    *earlier, last = done.err.splitlines() or [""]
    assert words in last, done.err[-2000:]
    assert all(line.startswith(("warning: ", "Usage: ", "Try ")) or not line for line in earlier), done.err[:2000]
    assert done.code == code
    assert max(map(len, done.err.splitlines())) < LONGEST_LINE + len(str(place))
    assert "Traceback" not in done.err


NUMBERS = {
    "NaN": cell(50, 3, "nan"),
    "infinity": cell(50, 3, "-inf"),
    "a huge reading": cell(50, 3, "1e308"),
    "an impossible latitude": cell(3, 2, "1e300", "csv/gnss.csv"),
    "an infinite altitude": cell(3, 4, "1e999", "csv/gnss.csv"),
    "a huge status": cell(3, 5, "1e300", "csv/gnss.csv"),
    "a huge sigma": cell(3, 6, "1e300", "csv/gnss.csv"),
    "a pose beyond all space": cell(5, 2, "1e300", "csv/lidar.csv"),
    "an arrival in 2255": cell(-1, 1, "9000000000000000000"),
    "stamps beyond 2038": all_later(1_400_000_000),
    "stamps before 1970": all_later(-3_000_000_000),
    "stamps from the boot": all_later(-1_700_000_000),
    "lines that end as on Windows": recoded("csv/imu.csv", lambda text: text.replace("\n", "\r\n").encode()),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_single_numbers_that_are_wrong_end_no_replay(name, place):
    NUMBERS[name]()
    done = holdfast("replay", "csv", "-c", "machine.yaml", "-o", "out")
    assert done.code == 0, done.err
    for track in Path("out").glob("*.tum"):
        assert b"nan" not in track.read_bytes() and b"inf" not in track.read_bytes()


def test_a_damaged_summary_of_an_older_run_is_no_reason_to_fail_in_a_batch(place):
    """What an earlier batch left may be broken: it is run again."""
    Path("out/csv").mkdir(parents=True)
    for name in ("out", "out/csv"):
        (Path(name) / ".holdfast").touch()  # of a run that was killed
    Path("out/csv/run.json").write_text("[")
    done = holdfast("batch", "csv", "-c", "machine.yaml", "-o", "out", "--duration", 1)
    assert "1 of 1 runs" in done.out + done.err
    assert "Traceback" not in done.out + done.err


@pytest.mark.parametrize("duration", ["-4", "0", "nan", "inf"])
def test_a_batch_of_an_impossible_duration_is_refused_before_anything_is_made(place, duration):
    """Each of its runs failed by itself."""
    done = holdfast("batch", "csv", "-c", "machine.yaml", "-o", "out", "--duration", duration)
    assert done.code == 2
    assert done.err == f"error: --duration {duration}: must be > 0 and <= 1e+09\n"
    assert not Path("out").exists()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a window needs no variable")
def test_a_window_without_a_display_is_one_line(place, monkeypatch):
    pytest.importorskip("rerun")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    done = holdfast("view", "drive.mcap")
    assert done.code == 2
    assert done.err == (
        "error: window: there is no display (DISPLAY, WAYLAND_DISPLAY are not set): "
        "write a file *.rrd, or name a viewer that runs, as --help says\n"
    )


def test_there_are_more_than_forty_kinds():
    assert len(CASES) + len(NUMBERS) > 90

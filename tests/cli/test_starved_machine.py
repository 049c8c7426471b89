"""A machine without memory: mistakes are told before libraries are loaded, and what cannot be loaded in one line."""

import subprocess
import sys

import pytest

from holdfast import cli


@pytest.mark.parametrize("option", ["--voxel", "--max-range", "--keep-above"])
def test_numbers_of_which_no_map_can_be_made_are_refused_before_any_library_is_loaded(option):
    """Loading pyarrow, gtsam and LLVM for it failed in as many ways as there are libraries (`map --voxel nan`)."""
    program = (
        "import sys\nfrom holdfast.cli import main\n"
        f"sys.argv = ['holdfast', 'map', 'out', 'a.mcap', '{option}', 'nan']\n"
        "try:\n    main()\nfinally:\n"
        "    print({'numpy', 'gtsam', 'rerun', 'laspy', 'pyproj', 'matplotlib', 'numba'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "set()\n")
    assert done.stderr.startswith(f"error: {option} nan: must be from ")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (MemoryError(), "error: no memory is left on this machine"),
        (ImportError("libarrow.so:\nfailed to map segment"), "(libarrow.so: failed to map segment)"),
    ],
)
def test_a_library_that_cannot_be_loaded_is_one_line(monkeypatch, capsys, error, words):
    def fail(_):
        raise error

    monkeypatch.setattr(cli, "import_module", fail)
    monkeypatch.setattr(sys, "argv", ["holdfast", "info", "a.mcap"])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line
    assert caught.value.code == 1

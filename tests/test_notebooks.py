"""The notebooks of the docs run, and what is stored in them is what they print.

`python tests/test_notebooks.py` executes them and stores what they print.
"""

from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "docs" / "notebooks").glob("*.ipynb"))
TIMEOUT_S = 600


def executed(path):
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    notebook = nbformat.read(path, as_version=4)
    nbclient.NotebookClient(notebook, timeout=TIMEOUT_S, kernel_name="python3").execute()
    return notebook


def test_there_are_two_notebooks_of_at_most_ten_cells_each():
    nbformat = pytest.importorskip("nbformat")
    assert [path.stem for path in NOTEBOOKS] == ["kitti_drive", "outage"]
    for path in NOTEBOOKS:
        assert len(nbformat.read(path, as_version=4).cells) <= 10


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_was_stored_executed(path):
    nbformat = pytest.importorskip("nbformat")
    stored = nbformat.read(path, as_version=4)
    ran = executed(path)
    for before, after in zip(stored.cells, ran.cells, strict=True):
        if after.cell_type == "code":
            assert before.execution_count is not None, before.source
            assert [one.output_type for one in before.outputs] == [one.output_type for one in after.outputs]


if __name__ == "__main__":
    import nbformat

    for path in NOTEBOOKS:
        notebook = executed(path)
        for cell in notebook.cells:
            cell.metadata.pop("execution", None)  # when it ran
        nbformat.write(notebook, path)

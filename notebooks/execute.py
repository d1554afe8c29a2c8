"""Execute notebooks, and store them with their outputs: python notebooks/execute.py [NOTEBOOK ...] [--out FOLDER]."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import matplotlib.font_manager  # noqa: F401  (builds its cache of fonts, of which it would tell in a notebook)
import nbformat
import typer
from jupyter_client.kernelspec import KernelSpecManager
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
from rich import print

FOLDER = Path(__file__).parent
MINUTES = 10
"""That one cell may take, on a busy machine."""


def main(
    notebooks: Annotated[list[Path] | None, typer.Argument(help="All of them unless told otherwise.")] = None,
    out: Annotated[Path | None, typer.Option(help="Where to store them, unless where they are.")] = None,
) -> None:
    """Execute notebooks in their own folder, by the Python that runs this, and store them if all has gone well."""
    for path in notebooks or sorted(FOLDER.glob("*.ipynb")):
        print(f"{path} ...")
        notebook = nbformat.read(path, as_version=4)
        _execute(notebook)
        nbformat.write(_without_what_varies(notebook), (out or path.parent) / path.name)


def _execute(notebook: nbformat.NotebookNode) -> None:
    this_python = KernelSpecManager(kernel_dirs=[])  # not an installed kernel, which could be another Python's
    with TemporaryDirectory() as sockets:
        kernel = AsyncKernelManager(
            kernel_name="python3", kernel_spec_manager=this_python, transport="ipc", ip=f"{sockets}/kernel"
        )
        client = NotebookClient(
            notebook,
            km=kernel,
            timeout=60 * MINUTES,
            resources={"metadata": {"path": str(FOLDER)}},
            record_timing=False,
            coalesce_streams=True,
        )
        client.execute(cleanup_kc=True)


def _without_what_varies(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Without versions and names of cells that change each time, for clean diffs."""
    notebook.metadata = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    for number, cell in enumerate(notebook.cells):
        cell.id, cell.metadata = f"cell-{number}", {}
    return notebook


if __name__ == "__main__":
    typer.run(main)

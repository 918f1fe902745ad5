"""Write the generated pages of the site: ``python -m docs.pages.write``, as the build of the site does."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from docs.pages.command_line import write_commands
from docs.pages.environment import write_environment, write_index
from docs.pages.formula import write_examples, write_operators, write_predicates
from docs.pages.options import write_options
from docs.pages.pictures import PLOTS, make_pictures
from docs.pages.scenario_file import write_keys
from impact_envs import list_scenarios

GENERATED = Path(__file__).parents[1] / "generated"
# Where it is set to 0 the site is built without films and plots, in seconds.
WITH_PICTURES = "DOCS_PICTURES"


def write_pages(folder: Path = GENERATED) -> None:
    """Write all pages and pieces of pages, and make films and plots.

    Args:
        folder: that takes them; pages of an earlier build are removed.
    """
    static, pages = folder / "static", folder / "environments"
    shutil.rmtree(pages, ignore_errors=True)
    for made in (static, pages):
        made.mkdir(parents=True, exist_ok=True)
    names, films = list_scenarios(), dict[str, str]()
    if os.environ.get(WITH_PICTURES) != "0":
        films = make_pictures(static, names)
    else:
        for file in PLOTS:
            (static / file).touch()
    (pages / "index.md").write_text(write_index(names), encoding="utf-8")
    for name in names:
        (pages / f"{name}.md").write_text(write_environment(name, films.get(name)), encoding="utf-8")
    pieces = {
        "keys": write_keys,
        "operators": write_operators,
        "predicates": write_predicates,
        "examples": write_examples,
        "commands": write_commands,
        "options": write_options,
    }
    for piece, write in pieces.items():
        (folder / f"{piece}.txt").write_text(write(), encoding="utf-8")


if __name__ == "__main__":
    write_pages()

"""Every block of code on the pages runs: here, or by the test that is named."""

from __future__ import annotations

import shutil

import blocks
import numpy as np
import pytest
from cli.ros1 import packages
from PIL import Image
from places import ROOT

import mdm
from mdm.cli import main
from mdm.maps import Edge, Graph, Node, Pose, save_graph
from mdm.models import Factor, Space

RUN = [
    "docs/start.md",
    "docs/how-to.md",
    "docs/moving.md",
    "docs/solving.md",
    "docs/safety.md",
    "docs/maps.md",
    "docs/formats.md",
]
"""Pages whose blocks run here, one after the other, in a folder of their own."""

ELSEWHERE = {
    "README.md": "test_documentation: its program is an example, its commands name all verbs",
    "docs/actions.md": "test_errands: what it shows are parts of the examples, which run",
    "docs/configuration.md": "test_documentation: its files are checked",
    "docs/models.md": "test_documentation: its programs print what it says",
    "docs/problems.md": "test_documentation, test_problem: sizes, values and commands",
    "docs/teams.md": "test_documentation, test_processes: its programs run",
    "docs/tutorial.md": "test_examples: its steps print what it says; test_examples of mdm examples copies them",
}
"""Pages whose blocks are run by tests of their own."""


def files(folder, page):
    """Put what a page speaks of into a folder."""
    if page == "docs/solving.md":
        tiger = mdm.problems.tiger(discount=0.95)
        mdm.save_model(tiger, folder / "tiger.pomdp")
        mdm.save_policy(mdm.solve(tiger, gap=1).policy, folder / "tiger.vf")
        for name in "ab":
            assert main(["solve", "tiger.pomdp", "--gap", "1", "--history", f"{name}.json"]) == 0
        cells = ["left", "middle", "right"]
        states = Space([Factor("robot", cells), Factor("target", cells)])
        chase = mdm.models.MDP(
            [np.eye(9)] * 2, np.arange(18.0).reshape(9, 2), discount=0.9, states=states, actions=["go", "tag"]
        )
        mdm.save_model(chase, folder / "tag.pomdpx")
        mdm.save_policy(mdm.solve(chase).policy, folder / "tag.npz")
    elif page == "docs/moving.md":
        package = packages.rounds(folder).rename(folder / "mdm_example")
        for path in [path for path in package.rglob("*") if path.is_file()]:
            path.write_text(path.read_text().replace("rounds", "mdm_example"))

    elif page == "docs/maps.md":
        floor(folder)


def floor(folder):
    """Write a floor of three rooms in a row, with doors between them."""
    rooms, cells = ["Hall", "Kitchen", "Office"], np.full((40, 120), 254, np.uint8)
    cells[[0, -1]] = 0
    cells[:, [0, 40, 80, -1]] = 0
    cells[14:26, [40, 80]] = 254
    (folder / "map.pgm").write_bytes(b"P5 120 40 255\n" + cells.tobytes())
    (folder / "map.yaml").write_text(
        "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.2\nnegate: 0\n"
    )
    labels = np.where(cells == 254, np.arange(120) // 40 + 1, 0).astype(np.uint8)
    Image.fromarray(labels).save(folder / "labels.png")
    (folder / "predicate_labels.yaml").write_text("".join(f"{room}: {place}\n" for place, room in enumerate(rooms, 1)))
    nodes = [Node(room, Pose(4.0 * place + 2.0, 2.0)) for place, room in enumerate(rooms)]
    ways = [Edge("Hall", "Kitchen", "Up"), Edge("Kitchen", "Office", "Up")]
    ways += [Edge("Office", "Kitchen", "Down"), Edge("Kitchen", "Hall", "Down")]
    save_graph(Graph(tuple(nodes), tuple(ways)), folder / "graph.xml")
    shutil.copyfile(folder / "graph.xml", folder / "site.tmap2")  # told by its content
    for level, name in (("ground", "Hall"), ("upper", "Landing")):
        (folder / level).mkdir()
        for file in ("map.pgm", "map.yaml", "labels.png", "graph.xml"):
            shutil.copyfile(folder / file, folder / level / file)
        text = (folder / "graph.xml").read_text()
        (folder / level / "graph.xml").write_text(text.replace("Hall", name))


class Motors:
    """What a page takes for given."""

    @staticmethod
    def cut():
        """Cut the power."""


def scope(page):
    """Return the names that a page takes for given."""
    return {"docs/safety.md": {"mdm": mdm, "motors": Motors}, "docs/maps.md": {"Pose": Pose}}.get(page, {})


@pytest.mark.parametrize("page", RUN)
def test_every_block_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    files(tmp_path, page)
    names, folder = scope(page), tmp_path
    for block in blocks.blocks(page):
        if page == "docs/maps.md" and block.language == "console":
            continue  # its recipes run in cli/map/test_robot, as they stand
        if "not-run" not in block.info:
            folder = blocks.run(
                block, tmp_path if block.language == "console" and "cd " in block.text else folder, names
            )


def test_every_page_with_blocks_is_run_somewhere():
    pages = ["README.md", *(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md"))]
    made = {"docs/reference/names", "docs/reference/commands", "docs/reference/faults", "docs/reference/file"}
    told = {page for page in pages if blocks.blocks(page) and not page.startswith(tuple(made))}
    languages = {block.language for page in told for block in blocks.blocks(page)}
    assert languages <= {"python", "console", "toml", "text", "xml"}
    runnable = {
        page
        for page in told
        if any(block.language != "text" and "not-run" not in block.info for block in blocks.blocks(page))
    }
    assert runnable == {*RUN, *ELSEWHERE}


def test_what_does_not_run_says_why():
    every = [block for page in (*RUN, *ELSEWHERE) for block in blocks.blocks(page)]
    reasons = [block.info["not-run"] for block in every if "not-run" in block.info]
    assert all(len(reason.split()) > 2 for reason in reasons)
    assert len(reasons) <= 5

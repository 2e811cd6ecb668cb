"""Every block on the pages runs here, or is checked by the tests that it names, or says why it cannot run."""

from __future__ import annotations

import asyncio
import re
import shutil

import blocks
import numpy as np
import pytest
from cli.ros1 import packages
from PIL import Image
from places import EXAMPLES, ROOT, TIGER_VECTORS

import mdm
from mdm.cli import main
from mdm.maps import Edge, Graph, Node, Pose, save_graph
from mdm.models import Factor, Space
from mdm.testing import capture_decisions, run_virtual

PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")]
PAGES = sorted(page.relative_to(ROOT).as_posix() for page in PAGES)
PAGES = [page for page in PAGES if not page.startswith(("docs/reference/", "docs/_build/")) and blocks.blocks(page)]
"""Pages whose blocks run here, one after the other, in a folder of their own; those of the reference are made."""


def files(folder, page):
    """Put what a page speaks of into a folder."""
    if page == "docs/solving.md":
        tiger = mdm.problems.tiger(discount=0.95)
        mdm.save_model(tiger, folder / "tiger.pomdp")
        shutil.copyfile(TIGER_VECTORS, folder / "tiger.vf")
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
    elif page == "README.md":
        shutil.copytree(EXAMPLES, folder / "examples")
    elif page == "docs/why-this-action.md":
        for path in EXAMPLES.glob("tiger.*"):
            shutil.copyfile(path, folder / path.name)
    elif page == "docs/maps.md":
        floor(folder)
    elif page == "docs/statistics.md":
        pytest.importorskip("navground")


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
        (folder / level).mkdir(exist_ok=True)
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
    given = {"docs/safety.md": {"motors": Motors}, "docs/maps.md": {"Pose": Pose}}
    return {"mdm": mdm} | given.get(page, {})


EPISODES = re.compile(r"episodes\.|table\[")
"""What the blocks of docs/records.md on episodes have, which share nothing with those on the patrol."""

LONG = ["docs/solving.md", "docs/how-to.md", "docs/start.md"]
"""Pages with many episodes, solvers or a pytest of their own."""


def run(page, folder, *, wanted=lambda block: True, most=None, known=()):
    files(folder, page)
    names, here = scope(page) | dict(known), folder
    for block in filter(wanted, blocks.blocks(page)):
        if block.info.keys() & {"checked", "not-run"}:
            continue
        if page == "docs/maps.md":
            floor(folder)
        begins = block.language == "console" and "cd " in block.text
        here = blocks.run(block, folder if begins else here, names, most=most)


@pytest.mark.parametrize(
    "page", [page for page in PAGES if page not in {"docs/records.md", "docs/solving.md", "docs/how-to.md"}]
)
def test_every_block_runs(page, tmp_path, monkeypatch):
    """With few episodes; the tests of a page's project are called in this process."""
    monkeypatch.chdir(tmp_path)
    run(page, tmp_path, most=20)


@pytest.mark.parametrize("part", ["first", "sweeps", "others"])
def test_every_answer_runs(part, tmp_path, monkeypatch):
    """The first answers, which make projects of their own, sweeps, which take the longest, and the others."""
    page = "docs/how-to.md"
    lines = (ROOT / page).read_text(encoding="utf-8").splitlines()
    questions = ("… use my own particle filter?", "… vary the parameters of a model?", "… choose a team mode?")
    others, sweeps, after = [1 + lines.index(f"## {question}") for question in questions]
    imported = {"asyncio": asyncio, "run_virtual": run_virtual, "capture_decisions": capture_decisions}

    def wanted(block):
        found = "first" if block.line < others else "sweeps" if sweeps < block.line < after else "others"
        return found == part

    monkeypatch.chdir(tmp_path)
    run(page, tmp_path, wanted=wanted, most=20, known={} if part == "first" else imported)


OF_RECORDS = {"episodes": EPISODES, "pictures": re.compile("mdm plot"), "replays": re.compile(r"\Amdm replay")}
"""The kinds of blocks on docs/records.md that need no more than the record, which the first block makes."""


@pytest.mark.parametrize("kind", [pytest.param("episodes", marks=pytest.mark.slow), "pictures", "replays", ""])
def test_every_block_on_records_runs(kind, tmp_path, monkeypatch):
    def wanted(block):
        found = next((name for name, pattern in OF_RECORDS.items() if pattern.search(block.text)), "")
        return found == kind or (kind != "episodes" and "mdm run patrol/" in block.text)

    monkeypatch.chdir(tmp_path)
    run("docs/records.md", tmp_path, wanted=wanted)


@pytest.mark.slow
@pytest.mark.parametrize("page", LONG)
def test_every_block_runs_as_it_stands(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(page, tmp_path)


def test_what_others_check_they_know():
    for page in PAGES:
        for block in blocks.blocks(page):
            if "checked" in block.info:
                tests = (ROOT / block.info["checked"]).read_text(encoding="utf-8")
                name = page.rsplit("/", 1)[-1]
                assert re.search(rf"\b{re.escape(name)}\b", tests), (page, block.line)


def test_what_does_not_run_says_why():
    every = [block for page in PAGES for block in blocks.blocks(page)]
    reasons = [block.info["not-run"] for block in every if "not-run" in block.info]
    assert all(len(reason.split()) > 1 for reason in reasons)
    assert len(reasons) <= 8
    assert len(every) > 80

"""Every benchmark runs and writes what it measured; speeds are not judged here.

Two of them do so in the default ring: what they all share, and that results are looked at, is seen there.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"


def has_pinned_commits():
    rows = tomllib.loads((BENCHMARKS / "gate.toml").read_text(encoding="utf-8"))["row"]
    found = (subprocess.run(["git", "cat-file", "-e", row["commit"]], cwd=BENCHMARKS).returncode for row in rows)
    return not any(found)


@pytest.mark.parametrize(
    "name",
    [
        "ticks",
        "recording",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in (
                "decision_latency",
                "gate",
                "startup",
                "parse",
                "sarsop",
                "belief",
                "policy",
                "monitors",
                "simulation",
                "workers",
                "solvers",
                "verification",
                "tree_search",
                "communication",
                "intervals",
                "places",
                "maps",
                "building",
                "page",
                "opening",
                "team_bridge",
                "team_latency",
                "team_memory",
                "team_radio",
            )
        ),
    ],
)
def test_benchmark(tmp_path, name):
    if name == "decision_latency":
        pytest.importorskip("pykka")
    if name == "gate" and not has_pinned_commits():
        pytest.skip("the commits that it names are not in this clone")
    if name in {"recording", "opening"}:
        pytest.importorskip("mcap")
    if name in {"team_bridge", "team_latency", "team_memory"}:
        pytest.importorskip("zenoh")
    if name == "page":
        pytest.importorskip("websockets")
    output = tmp_path / "out.json"
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / f"{name}.py"), "--quick", "--output", str(output)],
        capture_output=True,
        text=True,
        timeout=400,
    )
    assert done.returncode == 0 or (name == "gate" and "slower" in done.stdout), done.stderr
    results = json.loads(output.read_text())
    assert results["benchmark"] == name
    assert results["machine"]["python"]
    if name == "decision_latency":
        assert {"mdm: MDP, 12 states", "asyncio.Queue tasks", "pykka actors", "direct call", "mdm: dectiger"} <= {
            row["case"] for row in results["latency"]
        }
        assert {"mdm: the same, a batch of two sensors", "asyncio tasks, as tight as can be"} <= {
            row["case"] for row in results["latency"]
        }
        *ours, bare = results["threads"]
        assert len(ours) == 2
        assert all(row["median_us"] > 0 for row in (*ours, bare))
        (saturation,) = results["saturation"]
        assert saturation["lost"] == 0
        assert saturation["stream took"] + saturation["stream dropped (counted)"] == saturation["states"] + 1
    elif name == "gate":
        cases = [row["case"] for row in results["rows"]]
        assert cases == ["mdp", "batch", "dectiger", "300", "1000", "thread", "recorded"]
        assert all(row["verdict"] in {"holds", "slower"} for row in results["rows"])
        assert done.returncode == ("slower" in [row["verdict"] for row in results["rows"]])
    elif name == "recording":
        (written,) = results["written"]
        assert written["messages"] >= 4 * written["decisions"]  # a stimulus, a decision, and a life's begin and end
        assert written["dropped"] == 0
        for rows in (results["latency"], results["share"]):
            assert [row["case"] for row in rows] == ["alone", "recorded"]
    elif name == "solvers":
        assert {row["problem"] for row in results["mdps"]} == {"forest", "grid", "large grid"}
        assert all(float(row["error"]) <= 1e-3 for row in results["mdps"])
    elif name == "verification":
        assert len(results["rows"]) == 9
        assert all(float(row["error"]) <= 1e-8 * max(1.0, row["greatest"]) for row in results["rows"])
    elif name == "team_bridge":
        assert len(results["bridge"]) == 6
    elif name == "team_latency":
        assert len(results["ways"]) == 10
        assert all(0 < row["until the leader's callback"] < row["calls"] for row in results["calls"])
        assert all(row["steps a second"] > 0 for row in results["steps"])
    elif name == "team_memory":
        assert all(row["RSS MB"] >= row["PSS MB"] > 0 for row in results["team_memory"])
        assert all(row["processor s"] > 0 for row in results["team_memory"])
    elif name == "team_radio":
        sound, lossy = results["steps"]
        assert sound["together %"] == 100 > lossy["together and whole %"]
        assert all(0 < row["median"] <= row["most"] for row in results["pauses"])
        assert {row["how"] for row in results["pauses"]} == {"connection ends", "silent"}
    elif name == "ticks":
        assert {row["way"] for row in results["ticks"]} == {"mdm", "loop.call_at", "asyncio.sleep"}
    elif name == "tree_search":
        assert all(row["lower"] <= row["upper"] for row in results["searches"])
        assert {row["search"] for row in results["ticks"]} == {"no search", "in a process of its own", "in the loop"}
    elif name == "parse":
        assert {row["file"].partition(".")[2] for row in results["parse"]} == {
            "pomdp",
            "pomdp.gz",
            "npz",
            "pomdpx",
            "pgmx",
        }
        assert all(row["entries of T"] == 400 and row["read_s"] > 0 for row in results["parse"])
    elif name == "belief":
        assert {row["case"] for row in results["updates"]} >= {"random", "support of 20"}
        assert {row["way"] for row in results["updates"]} >= {"mdm, without numba", "numpy, dense", "scipy, CSR"}
        assert results["build"][0]["states"] == 1000
        assert all(row["product_us"] > 0 for row in results["threads"])
    elif name == "monitors":
        assert len(results["monitors"]) == 5
        assert all(row["monitor_us"] > 0 for row in results["monitors"])
    elif name == "policy":
        assert {(row["vectors"], row["states"]) for row in results["choices"]} == {(5, 2), (100, 870)}
        assert all(row["us"] > 0 for row in results["choices"])
    elif name == "simulation":
        assert {row["way"] for row in results["simulation"]} == {"mdm.evaluate", "mdm.simulate", "numpy, by hand"}
        assert all(row["steps a second"] > 0 for row in results["simulation"])
    elif name == "workers":
        assert {(row["episodes"], row["workers"]) for row in results["workers"]} == {
            (name, count) for name in ("batches", "one by one", "decision loop") for count in range(3)
        }
    elif name == "communication":
        messages = {(row["problem"], row["policy"]): row["% of messages"] for row in results["communication"]}
        assert messages["dec-tiger", "Always"] == 100
        assert messages["dec-tiger", "Never"] == 0
    elif name == "intervals":
        assert {row["of"] for row in results["coverage"]} == {"T", "rates", "rates, without cut stays"}
        assert {row["of"] for row in results["hidden"]} == {"T, hidden", "O, hidden"}
        assert all(row["alarms"] <= row["runs"] for row in results["drift"])
    elif name == "places":
        assert {row["way"] for row in results["lookups"]} >= {"bytes", "ray casting, 6 rectangles"}
        assert all(row["median_us"] > 0 for row in (*results["poses"], *results["particles"]))
    elif name == "maps":
        assert results["drafts"][0]["neighbours right"] == "2 of 2"
        assert {row["way"] for row in results["drafts"]} >= {"one watershed", "nearest goal by path"}
        assert len(results["drafts"]) == 4
    elif name == "building":
        assert len(results["speeds"]) == 4
        assert all(row["times real time"] > 0 for row in results["speeds"])
    elif name == "sarsop":
        assert results["tiger_s"] > 0
    elif name == "page":
        assert [row["case"] for row in results["latency"]] == ["no page", "a page, nobody looks", "one client, 20 Hz"]
        assert all(row["median_us"] > 0 for row in (*results["latency"], *results["frames"]))
    elif name == "opening":
        assert [row["case"] for row in results["opening"]] == ["all read", "by its summary"]
        assert all(row["first_ms"] > 0 and row["any_ms"] >= 0 for row in results["opening"])
    else:
        assert all(row["median_ms"] > 0 for row in results["startup"])

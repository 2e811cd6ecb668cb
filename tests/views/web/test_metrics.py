"""Figures for Prometheus, read by the parser of its own Python client, against what was heard and computed here."""

from __future__ import annotations

import asyncio
import json
import math
import re
from collections import Counter

import pytest
from blocks import texts
from decided import ensemble, nothing
from hypothesis import given, strategies as st
from places import EXAMPLES, ROOT
from served import TOKEN, get, shown
from team_robots import over_beliefs, started

import mdm
from mdm import problems
from mdm.policies import DeterministicPolicy
from mdm.runtime import Latencies
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import run_virtual
from mdm.views.web.metrics import FAMILIES, Metrics, _histogram, _labels

parser = pytest.importorskip("prometheus_client.parser")
pytest.importorskip("websockets")


def read(text):
    """Return all samples, by name and labels; each once, in families of their own, each with a type and a help."""
    families = [*parser.text_string_to_metric_families(text.decode())]
    assert len({family.name for family in families}) == len(families)
    samples = [sample for family in families for sample in family.samples]
    found = {(each.name, frozenset(each.labels.items())): each.value for each in samples}
    assert len(found) == len(samples)
    assert all(family.documentation and family.type != "unknown" for family in families)
    return found


def of(found, name, **labels):
    """Return the values of a family's samples with these labels, by their other labels."""
    return {
        tuple(value for _, value in sorted(told - labels.items())): count
        for (each, told), count in found.items()
        if each == name and labels.items() <= told
    }


@given(*[st.text('ab"\\\n{}=, é\ud83d')] * 2)
def test_any_name_can_be_a_label(one, two):
    told = _labels("mdm_mode", ensemble=one, action=two).encode(errors="replace").decode()
    (family,) = parser.text_string_to_metric_families(f"{told} 1\n")
    assert family.samples[0].labels == {
        name: value.encode(errors="replace").decode() for name, value in (("ensemble", one), ("action", two))
    }


@given(st.lists(st.integers(1, 40_000_000_000) | st.sampled_from([1 << power for power in range(40)])))
def test_each_bucket_has_all_latencies_up_to_its_bound(nanoseconds):
    latencies = Latencies()
    for each in nanoseconds:
        latencies.record(each)
    figures = _histogram("mdm_latency_seconds", latencies.snapshot(), ensemble="robot")
    lines = [f"{name} {value}\n" for name, value in figures.items()]
    found = read(("# HELP mdm_latency_seconds x\n# TYPE mdm_latency_seconds histogram\n" + "".join(lines)).encode())
    for (bound,), count in of(found, "mdm_latency_seconds_bucket", ensemble="robot").items():
        assert count == sum(each <= round(float(bound) * 1e9) for each in nanoseconds) if bound != "+Inf" else True
    assert of(found, "mdm_latency_seconds_bucket", le="+Inf") == {("robot",): len(nanoseconds)}
    assert of(found, "mdm_latency_seconds_count") == {("robot",): len(nanoseconds)}
    assert of(found, "mdm_latency_seconds_sum")[("robot",)] == pytest.approx(sum(nanoseconds) / 1e9)


def fails():
    raise ValueError("no grip")


async def lasts():
    await asyncio.sleep(3.0)


def a_robot(**options):
    actions = {"go": nothing, "wait": lasts, 'say "yes"\n\\': fails}
    options = {"policy": DeterministicPolicy([0, 1, 2]), "actions": dict(enumerate(actions.values()))} | options
    return mdm.Ensemble("robot", **options)


@given(st.lists(st.integers(0, 2) | st.sampled_from(["stop", "start", "reset", 0.5, 4.0]), max_size=20))
def test_decisions_are_those_that_were_heard_and_no_count_ever_falls(script):
    async def main(runtime):
        robot, metrics, heard, actions = a_robot(), Metrics(runtime), Counter(), Counter()
        await runtime.start(robot)
        runtime.faults.subscribe(lambda fault: heard.update([fault.kind]))
        runtime.decisions.subscribe(lambda decision: actions.update([decision.action_name]))
        before = {}
        for step in script:
            if isinstance(step, float):
                await asyncio.sleep(step)
            elif isinstance(step, str):
                getattr(robot, step)()
            else:
                robot.publish_state(step)
            found = read(await metrics.text())
            counts = {key: value for key, value in found.items() if key[0].endswith(("_total", "_count", "_sum"))}
            assert all(value <= counts[key] for key, value in before.items())
            before = counts
            decided = of(found, "mdm_decisions_total", ensemble="robot")
            assert Counter({action: count for (action,), count in decided.items() if count}) == actions
            assert {"".join(key): value for key, value in of(found, "mdm_faults_total").items()} == heard
            modes = of(found, "mdm_mode", ensemble="robot")
            assert [mode for (mode,), value in modes.items() if value] == [robot.mode]
            assert sum(modes.values()) == 1

    run_virtual(main)


def test_decisions_are_counted_by_action_where_somebody_hears_lives_and_where_nobody_does():
    async def main(runtime):
        robot, metrics = a_robot(), Metrics(runtime)
        await runtime.start(robot)
        for state in (0, 1, 2, 0, 1, 1):
            robot.publish_state(state)
            await asyncio.sleep(0.1)
        quiet = of(read(await metrics.text()), "mdm_decisions_total", ensemble="robot")
        runtime.actions = robot.channel("lives", mdm.messages.ActionLife).subscribe(lambda _: None)
        for state in (0, 1, 2, 0, 1, 1):
            robot.publish_state(state)
            await asyncio.sleep(0.1)
        both = of(read(await metrics.text()), "mdm_decisions_total", ensemble="robot")
        assert both == {name: 2 * count for name, count in quiet.items()}
        assert [*quiet.values()] == [2, 3, 1]

    run_virtual(main)


def test_another_ensemble_of_the_same_name_counts_on():
    async def main(runtime):
        metrics = Metrics(runtime)
        for times in (3, 2):
            robot = a_robot()
            await runtime.start(robot)
            for _ in range(times):
                robot.publish_state(0)
            found = read(await metrics.text())
            await runtime.stop(robot)
        assert of(found, "mdm_decisions_total", ensemble="robot")[("0",)] == 5
        assert of(found, "mdm_latency_seconds_bucket", le="+Inf") == {("robot",): 5}

    run_virtual(main)


def test_entropy_is_that_of_the_belief_decided_on_as_a_share_of_the_greatest():
    async def main(runtime):
        robot, metrics = ensemble(), Metrics(runtime)
        await runtime.start(robot)
        before = of(read(await metrics.text()), "mdm_belief_entropy_ratio")
        robot.publish_observation("hear-left")
        sure = 0.85
        told = of(read(await metrics.text()), "mdm_belief_entropy_ratio", ensemble="robot")[()]
        assert before in ({}, {("robot",): 1.0})
        assert told == pytest.approx(-sure * math.log2(sure) - (1 - sure) * math.log2(1 - sure), abs=1e-6)

    run_virtual(main)


def test_a_team_tells_its_links_messages_and_losses():
    async def main(runtime):
        network, metrics = Network(runtime.clock, team="tigers", lease=0.5), Metrics(runtime)
        team = Team("tigers", ["left", "right"])
        left, _ = await started(runtime, team, network, over_beliefs(problems.dec_tiger()))
        await asyncio.sleep(2.0)
        both = read(await metrics.text())
        assert of(both, "mdm_team_live", team="tigers") == {("left", "right"): 1, ("right", "left"): 1}
        assert all(age <= 0.5 for age in of(both, "mdm_team_silence_seconds").values())
        network.crash("right")
        await asyncio.sleep(10.0)
        alone = read(await metrics.text())
        assert of(alone, "mdm_team_live", agent="left", team="tigers") == {("right",): 0}
        assert 9.4 < of(alone, "mdm_team_silence_seconds", agent="left", team="tigers")[("right",)] <= 10.5
        traffic = left.member.link.transport.statistics()
        for way in ("sent", "received"):
            counted = sum(each.messages for each in getattr(traffic, way).values())
            assert of(alone, f"mdm_team_{way}_messages_total", agent="left", team="tigers") == {(): counted}
        dropped = of(alone, "mdm_team_dropped_messages_total", agent="left", team="tigers")
        assert {reason: count for (reason,), count in dropped.items()} == traffic.dropped

    run_virtual(main)


def test_the_page_tells_them_to_who_brings_its_token_in_a_header():
    async def main(_, page):
        bearer = {"Cookie": None, "Authorization": f"Bearer {TOKEN}"}
        status, headers, body = await get(page, "/metrics", **bearer)
        assert (status, headers["Content-Type"]) == (200, "text/plain; version=0.0.4; charset=utf-8")
        assert of(read(body), "mdm_build_info") == {(mdm.__version__,): 1}
        assert (await get(page, "/metrics", Cookie=None, Authorization=f"bearer  {TOKEN}"))[0] == 200
        for path, brought in (
            ("/metrics", {}),
            ("/metrics", {"Cookie": None}),
            (f"/metrics?token={TOKEN}", {}),
            ("/metrics", {"Authorization": "Bearer"}),
            ("/metrics", {"Authorization": f"Basic {TOKEN}"}),
            ("/metrics", {"Authorization": f"Bearer {TOKEN}x"}),
        ):
            status, headers, body = await get(page, path, **brought)
            assert (status, headers["WWW-Authenticate"]) == (401, 'Bearer realm="mdm"')
            assert body == b"Metrics need this page's token: 'Authorization: Bearer TOKEN'; MDM_PAGE_TOKEN sets it.\n"
        assert (await get(page, "/metrics", Host="evil.example", **bearer))[0] == 421
        assert (await get(page, "/page.js", **bearer))[0] == 403

    shown(main)


def test_what_is_no_running_system_has_none_and_what_fails_says_so(monkeypatch):
    async def main(_, page):
        async def fails(self):
            raise RuntimeError("no figures")

        bearer = {"Authorization": f"Bearer {TOKEN}"}
        with monkeypatch.context() as patched:
            patched.setattr(Metrics, "text", fails)
            status, _, body = await get(page, "/metrics", **bearer)
            assert (status, body) == (500, b"The page has failed: RuntimeError: no figures\n")
        assert (await get(page, "/metrics", **bearer))[0] == 200
        monkeypatch.setattr(page._server, "_metrics", None)
        status, _, body = await get(page, "/metrics", **bearer)
        assert (status, body[:42]) == (404, b"Metrics are of a running system: a record ")

    shown(main)


def test_many_ensembles_are_looked_at_in_slices():
    async def main(runtime):
        metrics, turns = Metrics(runtime), 0
        for number in range(100):
            await runtime.start(mdm.Ensemble(f"r{number}", policy=DeterministicPolicy([0]), actions={0: nothing}))

        async def turn():
            nonlocal turns
            while True:
                await asyncio.sleep(0)
                turns += 1

        beside = asyncio.create_task(turn())
        found = read(await metrics.text())
        beside.cancel()
        assert len(of(found, "mdm_idle")) == 100
        assert turns >= 1

    asyncio.run(_real(main))


async def _real(main):
    async with mdm.Runtime(log=False, watchdog=None, signals=False) as runtime:
        await main(runtime)


def test_the_dashboard_shows_every_family_and_nothing_that_is_not_there():
    dashboard = json.loads((EXAMPLES / "grafana" / "dashboard.json").read_text())
    panels = [panel for panel in dashboard["panels"] if panel["type"] != "row"]
    shown_here = {
        re.sub(r"_(bucket|sum|count)$", "", name)
        for panel in panels
        for target in panel["targets"]
        for name in re.findall(r"\bmdm_\w+", target["expr"])
    }
    assert shown_here == set(FAMILIES)
    assert {panel["datasource"]["uid"] for panel in panels} == {"${datasource}"}
    variables = {each["name"]: each for each in dashboard["templating"]["list"]}
    assert variables["datasource"]["type"] == "datasource"
    assert all(panel["fieldConfig"]["defaults"]["unit"] and panel["description"] for panel in panels)
    cells = Counter(
        (x, y)
        for panel in dashboard["panels"]
        for x in range(panel["gridPos"]["x"], panel["gridPos"]["x"] + panel["gridPos"]["w"])
        for y in range(panel["gridPos"]["y"], panel["gridPos"]["y"] + panel["gridPos"]["h"])
    )
    assert max(cells.values()) == 1


def test_the_pages_say_what_there_is():
    page = (ROOT / "docs" / "page.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(mdm_\w+)` \| (\w+) \| .* \| (.*) \|$", page, re.MULTILINE)
    assert {name: f"{kind} {words}." for name, kind, words in rows} == FAMILIES
    (snippet,) = texts("docs/how-to.md", "yaml")
    assert snippet == (EXAMPLES / "grafana" / "prometheus.yml").read_text(encoding="utf-8")


def test_names_are_as_prometheus_would_have_them():
    for name, told in FAMILIES.items():
        kind, _, words = told.partition(" ")
        assert re.fullmatch(r"mdm(_[a-z]+)+", name)
        assert name.endswith("_total") == (kind == "counter")
        assert kind != "histogram" or name.endswith("_seconds")
        assert words.endswith(".")

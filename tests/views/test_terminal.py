"""A run as text, against what its frames say."""

from __future__ import annotations

import io
import re

import pytest

from mdm.snapshots import Event, Frame, Scene
from mdm.snapshots.frame import (
    BeliefFrame,
    CauseFrame,
    Detail,
    EnsembleFrame,
    EnsembleScene,
    Judgement,
    LifeFrame,
    PredicateScene,
)
from mdm.views.terminal import Terminal

console = pytest.importorskip("rich.console")

SCENE = Scene(
    *("1", "live", "robot.toml", 0, 0.0, 0.0),
    ensembles=(EnsembleScene("top", -1, "", "MDP"), EnsembleScene("top/walk", 0, "Go", "POMDP")),
    predicates=(PredicateScene("Near", "set by code"), PredicateScene("Far", "not Near"), PredicateScene("Lit", "")),
)
FRAME = Frame(
    65.5,
    (
        EnsembleFrame("deciding", 5.0, live=(LifeFrame("Go", 60.0),)),
        EnsembleFrame("safe", 65.0, causes=(CauseFrame("stale_input", "Near", 65.0, "look at the sensor"),)),
    ),
    (True, False, None),
    (1.0, 1.0, 2.0),
    judgements=(
        Judgement("safe", "top/walk", "", "wrong", 1, 65.0, "is safe (stale_input)", "Near", "look at the sensor"),
        Judgement("hangs", "top", "Go", "wrong", 1, 60.0, "Go has lasted for more than 99 s", "it usually takes 2 s"),
        Judgement("idle", "top", "", "look", 1, 1.0, "has nothing to do", until=5.0),
    ),
    headline="top/walk: is safe (stale_input), since 01:05.0",
    details={"top/walk": Detail(state="hall", belief=BeliefFrame((("hall", 0.75), ("lab", 0.25)), 0.0, 2, 0.8))},
)


def printed(terminal, frame=FRAME, width=120, **options):
    out = console.Console(file=io.StringIO(), width=width, no_color=True)
    out.print(terminal.picture(frame, **options))
    return out.file.getvalue()


def test_a_picture_says_modes_actions_causes_and_beliefs():
    terminal = Terminal(SCENE)
    terminal.choose(1)
    assert terminal.close == ("top/walk",)
    text = printed(terminal, status="● live")
    assert re.search(r"robot.toml +01:05.5 +● live", text)
    assert "✕ top/walk: is safe (stale_input), since 01:05.0 Near → look at the sensor" in text
    assert "✕ top: Go has lasted for more than 99 s, since 01:00.0 it usually takes 2 s" in text
    assert "has nothing to do" not in text
    assert re.search(r"top +▶ deciding +Go +5.5 s", text)
    assert re.search(r"> +walk +■ safe", text)
    assert re.search(r"hall +█{15}░{5} +75.0%", text)
    assert re.search(r"lab +█{5}░{15} +25.0%", text)
    assert "? Lit ● Near and 1 false" in text


def test_agents_are_told_apart_and_idle_since_they_have_nothing_to_do():
    ensembles = tuple(EnsembleScene(f"{agent}/patrol", -1, "", "MDP") for agent in ("ada", "bob"))
    scene = Scene("1", "live", "team.toml", 0, 0.0, 0.0, ensembles=ensembles, predicates=())
    ended = CauseFrame("end", "the runtime ends", 9.0, "")
    modes = EnsembleFrame("deciding", 1.0, idle=9.5), EnsembleFrame("stopped", 9.0, causes=(ended,))
    text = printed(Terminal(scene), Frame(10.0, modes, (), ()))
    assert re.search(r"> ada/patrol +- idle +0.5 s", text)
    assert "bob/patrol" in text
    assert "✓ nothing is named" in text


def test_events_are_those_up_to_the_frame():
    terminal = Terminal(SCENE)
    terminal.hear([Event(number, float(number), "decision", "top", f"act{number}") for number in range(1, 100)])
    text = printed(terminal)
    assert "act65" in text
    assert "act66" not in text
    assert "act10 " not in text  # there is room for the last ones alone


def test_where_a_judgement_begins_is_an_event_with_its_words():
    terminal = Terminal(SCENE)
    facts = {"detail": "go has lasted for 10 s", "life": 1}
    terminal.hear(
        [
            Event(1, 10.0, "judgement", "top", "hangs", status="begins", **facts),
            Event(2, 20.0, "judgement", "top", "hangs", status="over", life=1),
        ]
    )
    text = printed(terminal)
    assert re.search(r"00:10.0 top +\? hangs +go has lasted for 10 s", text)
    assert re.search(r"00:20.0 top +\? hangs: over", text)


def test_a_long_sentence_leaves_time_and_source_whole():
    terminal = Terminal(SCENE)
    terminal.hear([Event(1, 10.0, "fault", "top", "waiting", detail="cannot decide while all is unknown " * 9)])
    assert re.search(r"00:10.0 top +⚠ waiting +cannot decide .*…", printed(terminal, width=60))


def test_the_choice_stays_within_the_list_and_the_lines_within_the_width():
    terminal = Terminal(SCENE)
    terminal.choose(-1)
    assert terminal.selected == 0
    terminal.choose(5)
    assert terminal.selected == 1
    assert max(map(len, printed(terminal, width=40).splitlines())) <= 40


def test_a_thousand_ensembles_take_no_more_than_the_screen():
    many = tuple(EnsembleScene(f"robot{number}", -1, "", "MDP") for number in range(1000))
    scene = Scene("1", "record", "run", 0, 0.0, 100.0, many, ())
    frame = Frame(1.0, tuple(EnsembleFrame("deciding", 0.0) for _ in many), (), ())
    terminal = Terminal(scene)
    terminal.choose(500)
    text = printed(terminal, frame, height=30)
    assert len(text.splitlines()) <= 30
    assert re.search(r"> +robot500 ", text)

"""Explanations in words."""

from __future__ import annotations

import msgspec

from mdm.explanation import (
    BeliefChange,
    Chance,
    Explanation,
    FactorChange,
    Influence,
    Move,
    ObservationChange,
    Observed,
    StateChange,
    Weighed,
    brief,
    in_words,
)

WHOLE = Explanation(
    *(2, 1, "open-left", "alpha vectors"),
    belief=(Chance("tiger-right", 0.97), Chance("tiger-left", 0.03)),
    by="value",
    values=(Weighed(1, "open-left", 6.5), Weighed(0, "listen", 4.25), Weighed(2, "open-right", None)),
    second="listen",
    margin=2.25,
    moved_by=Influence(2, "", "hear-right", -3.0, 5.25, "listen", decisive=True),
    influences=(Influence(2, "", "hear-right", -3.0, 5.25, "listen", decisive=True),),
    otherwise=(BeliefChange(0.02, (Move("tiger-right", 0.97, 0.95), Move("tiger-left", 0.03, 0.05)), "listen"),),
    ways=1,
    next_states=(Chance("tiger-left", 0.5), Chance("tiger-right", 0.5)),
    next_observations=(Chance("hear-left", 0.5),),
    cannot=("the moon is not known",),
)


def but(**changes):
    return msgspec.structs.replace(WHOLE, **changes)


def test_a_whole_explanation():
    assert in_words(WHOLE) == (
        "Decision 2: 'open-left', by alpha vectors.\n"
        "The most probable states were tiger-right (0.97), tiger-left (0.03).\n"
        "Values: open-left 6.5, listen 4.25, open-right (no value).\n"
        "It is ahead of 'listen' by 2.25.\n"
        "The observation that moved it most was hear-right before decision 2: without it, it would have been behind by "
        "3, and the decision 'listen'.\n"
        "The smallest change that decides otherwise: 0.02 of the probability elsewhere (tiger-right 0.95 instead of "
        "0.97, tiger-left 0.05 instead of 0.03), then 'listen'.\n"
        "It expects next, of states tiger-left (0.5), tiger-right (0.5); of observations hear-left (0.5).\n"
        "Note: the moon is not known."
    )


def test_a_few_words():
    assert brief(WHOLE) == {
        "values": "open-left 6.5, listen 4.25, open-right (no value)",
        "ahead": "2.25 of listen",
        "moved_by": "hear-right before decision 2",
        "otherwise": "0.02 of the probability elsewhere (tiger-right 0.95 instead of 0.97, tiger-left 0.05 instead of "
        "0.03), then 'listen'",
        "expects": "tiger-left (0.5)",
    }
    assert brief(Explanation(0, 0, "go", "a table")) == {}


def test_probabilities_that_are_next_to_nothing():
    moved = BeliefChange(0.5, (Move("left", 6.748e-54, 0.5), Move("right", 1.0, 0.001)), "listen")
    believed = (Chance("right", 1.0), Chance("left", 1.22e-24), Chance("none", 0.0))
    text = in_words(but(belief=believed, otherwise=(moved,)))
    assert "were right (1), left (< 0.001), none (0)." in text
    assert "left 0.5 instead of < 0.001, right 0.001 instead of 1)" in text
    assert "e-" not in text


def test_margins():
    assert "'listen' counts as much; of equal ones the first action is chosen." in in_words(but(margin=0.0))
    assert "'listen' counts 2 more: it was not this comparison that chose." in in_words(but(margin=-2.0))
    assert "ahead of" not in in_words(but(margin=None, moved_by=None))


def test_influences():
    several = Influence(3, "robot2", "hears", 1.0, 1.25, "open-left", decisive=False)
    text = in_words(but(moved_by=several, influences=(several, several)))
    assert "Of the last 2 observations, robot2: hears before decision 3 moved it most: without it, it would" in text
    assert "have been ahead by 1." in text
    lost = Influence(3, "", "hears", None, None, "listen", decisive=True)
    assert "without it, this action would not even be compared, and the decision 'listen'." in in_words(
        but(moved_by=lost)
    )
    assert "without it, the decision would have been 'listen'." in in_words(but(moved_by=lost, margin=None))


def test_changes():
    tied = BeliefChange(1e-10, (), "listen")
    assert "decides otherwise: next to none, for 'listen' counts as much." in in_words(but(otherwise=(tied,)))
    state = StateChange((FactorChange("door", "open", "closed"), FactorChange("light", "on", "off")), "wait")
    text = in_words(but(otherwise=(state, state), ways=7))
    assert "(7 such changes): door closed instead of open and light off instead of on, then 'wait'; or door" in text
    plan = ObservationChange((Observed(4, "robot2", "left", "right"),), "wait")
    assert "robot2: right instead of left before decision 4, then 'wait'" in in_words(but(otherwise=(plan,)))
    many = BeliefChange(0.5, tuple(Move(f"s{place}", 0.1, 0.2) for place in range(6)), "wait")
    assert "and 2 more states" in in_words(but(otherwise=(many,)))


def test_nodes_states_and_searches():
    text = in_words(Explanation(0, 0, "go", "a plan", nodes=(3, 4), by="bound", effort=1234, values=WHOLE.values))
    assert "Decision 0: 'go', by a plan at nodes 3, 4." in text
    assert (
        "Values are at least: open-left 6.5, listen 4.25, open-right (no value), by a search that expanded 1,234"
        in text
    )
    assert "The state was hall." in in_words(Explanation(0, 0, "go", "a table", state="hall"))
    values = tuple(Weighed(action, f"a{action}", 1.0, 2.0) for action in range(10))
    assert "a7 1 (at most 2), 2 more" in in_words(Explanation(0, 0, "go", "a search", values=values))

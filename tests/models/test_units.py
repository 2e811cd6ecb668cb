"""What a discount is of: kept by all that a model becomes, converted or refused, never guessed."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from sentences import refused

import mdm
from mdm.errors import ModelError, ModelWarning
from mdm.formats import load_durations, save_durations
from mdm.formats.archive import npz
from mdm.models import Durations
from mdm.models.digest import digest, first_difference, parts
from mdm.models.units import in_words, ratio
from mdm.policies import DeterministicPolicy
from mdm.problems import forest, tag, tiger
from mdm.solvers import exact_values

UNITS = ["step", "second", 10.0]


def test_units_in_words_and_by_each_other():
    assert [in_words(unit) for unit in UNITS] == ["a step", "a second", "a step of 10 s"]
    assert [ratio(unit, "second") for unit in UNITS] == [None, 1.0, 10.0]
    assert [ratio(unit, "step") for unit in UNITS] == [1.0, None, None]
    assert ratio(10.0, 5.0) == 2.0
    for wrong in ("minute", 0.0, math.inf, True):
        with refused(ModelError):
            forest().with_discount(0.9, of=wrong)


@pytest.mark.parametrize("of", UNITS)
def test_what_a_model_becomes_has_its_unit(of, tmp_path):
    for made in (forest(), tiger(), tag()):
        model = made.with_discount(0.9, of=of)
        assert model.discount_of == of
        assert model.with_discount(0.8).discount_of == of
        others = [
            model.flatten(),
            model.revealed(),
            model.revealed().flatten(),
            model.sparingly(),
            model.step_by_step(),
        ]
        mdm.save_model(model, tmp_path / "model.npz")
        others.append(mdm.load_model(tmp_path / "model.npz"))
        if len(model.state_space) < 10:
            others.append(mdm.load_model(tmp_path / "model.npz", sparse=True))
        for other in others:
            assert (other.discount, other.discount_of) == (0.9, of)
        again = made.with_discount(0.9)
        assert (digest(model) == digest(again)) == (of == "step")
        assert (parts(model) == parts(again)) == (of == "step")
        if len(model.state_space) < 10:
            assert (first_difference(again, model) is None) == (of == "step")


@pytest.mark.parametrize("of", UNITS)
def test_a_policy_has_the_unit_of_its_model(of, tmp_path):
    model = forest().with_discount(0.9, of=of)
    policy = mdm.solve(model, durations=Durations(3.0, of="step" if of == "step" else "second")).policy
    mdm.save_policy(policy, tmp_path / "policy.npz", model)
    assert policy.discount_of == mdm.load_policy(tmp_path / "policy.npz").discount_of == of


def test_durations_keep_their_unit_and_their_rates(tmp_path):
    for of in ("step", "second"):
        save_durations(Durations([1.0, 2.0], 3, [[-1.0, 0.5]], of=of), tmp_path / "times.npz")
        again = load_durations(tmp_path / "times.npz")
        assert (again.of, again.means.tolist(), again.rates.tolist()) == (of, [1.0, 2.0], [[-1.0, 0.5]])


def test_older_archives_are_of_a_step(tmp_path):
    model, policy = forest(), DeterministicPolicy([0, 0, 1], 2)
    save_durations(Durations(3.0, of="second"), tmp_path / "times.npz")
    mdm.save_model(model.with_discount(0.9, of="second"), tmp_path / "model.npz")
    policy.discount_of = "second"
    mdm.save_policy(policy, tmp_path / "policy.npz", model)
    for name in ("times", "model", "policy"):
        header, arrays = npz.read(tmp_path / f"{name}.npz")
        told = msgspec.json.decode(header)
        assert {told.pop("discount_of", told.pop("of", None))} == {"second"}
        kept = {key: np.array(array) for key, array in arrays.items() if key != "rates"}
        npz.write(tmp_path / f"old-{name}.npz", msgspec.defstruct("Old", list(told))(**told), kept)
    durations, old = load_durations(tmp_path / "old-times.npz"), mdm.load_model(tmp_path / "old-model.npz")
    assert (durations.of, old.discount_of) == ("step", "step")
    assert mdm.load_policy(tmp_path / "old-policy.npz").discount_of == "step"
    discount = 1 / (1 - math.log(0.9) * 3.0)  # as it was before
    assert mdm.solve(old, durations=durations).upper == pytest.approx(mdm.solve(old.with_discount(discount)).upper)


@pytest.mark.parametrize("suffix", [".mdp", ".pomdpx"])
def test_a_format_without_units_says_so(suffix, tmp_path):
    model = forest().with_discount(0.9, of="second")
    with pytest.warns(ModelWarning, match="cannot say that a discount is of a second"):
        mdm.save_model(model, tmp_path / f"model{suffix}")
    assert mdm.load_model(tmp_path / f"model{suffix}").discount_of == "step"


USES = [
    lambda model, policy, durations: mdm.solve(model, durations=durations, gap=1e-9).upper,
    lambda model, policy, durations: float(model.initial_belief @ exact_values(model, policy, durations=durations)),
    lambda model, policy, durations: mdm.evaluate(model, policy, episodes=300, seed=1, durations=durations).mean,
]
POLICY = DeterministicPolicy([0, 0, 1], 2)


@pytest.mark.parametrize("use", USES)
def test_what_can_be_converted_is(use):
    seconds = Durations([[10.0, 30.0]] * 3, 2, [[-0.1, 0.2]] * 3)
    steps = Durations([[1.0, 3.0]] * 3, 2, [[-1.0, 2.0]] * 3, of="step")
    model = forest()
    same = use(model.with_discount(0.9 ** (1 / 10), of="second"), POLICY, seconds)
    assert use(model.with_discount(0.9, of=10.0), POLICY, seconds) == pytest.approx(same)
    assert use(model.with_discount(0.9 ** (1 / 2), of=5.0), POLICY, seconds) == pytest.approx(same)
    for of in ("step", 10.0):
        assert use(model.with_discount(0.9, of=of), POLICY, steps) == pytest.approx(same)
    assert use(model.with_discount(0.9, of=10.0), POLICY, None) == use(model.with_discount(0.9), POLICY, None)


@pytest.mark.parametrize("use", USES)
def test_what_cannot_be_converted_is_refused(use):
    model, seconds, steps = forest(), Durations(10.0), Durations(1.0, of="step")
    for of, durations in (("step", seconds), ("second", steps), ("second", None)):
        with refused(ModelError):
            use(model.with_discount(0.9, of=of), POLICY, durations)
    with refused(ModelError):
        mdm.simulate(model.with_discount(0.9, of="second"), POLICY, episodes=1)

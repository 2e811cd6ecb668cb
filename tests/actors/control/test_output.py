"""Output: decisions as messages, in their order, in time, and of beliefs no more than somebody wants."""

from __future__ import annotations

import numpy as np
import pytest
from decided import decided, ensemble, nothing, see

from mdm import BeliefTracker, Ensemble, VirtualClock
from mdm.messages import Action, Belief, Reward
from mdm.models import POMDP
from mdm.policies import AlphaVectors, BeliefPolicy, DeterministicPolicy
from mdm.testing import probe, run_virtual


def test_a_missed_deadline_runs_the_safe_action_instead():
    calls = []

    class Slow(DeterministicPolicy):
        def __init__(self, clock):
            super().__init__([1, 0])
            self.clock = clock

        def action(self, state):
            self.clock.behind += 200_000_000
            return super().action(state)

    class Clock(VirtualClock):
        behind = 0

        def now(self):
            return super().now() + self.behind

    from mdm import Runtime, run

    async def main():
        clock = Clock()
        async with Runtime(clock=clock, log=None) as runtime:
            faults = probe(runtime.faults)
            robot = Ensemble(
                "robot",
                policy=Slow(clock),
                actions={"a": lambda: calls.append("a"), "b": lambda: calls.append("b")},
                deadline=0.1,
                safe_action=lambda: calls.append("safe"),
            )
            await runtime.start(robot)
            robot.publish_state(0)
            assert calls == ["safe"]
            assert [(fault.kind, fault.source) for fault in faults] == [("deadline", "robot/control")]
            assert "200.000 ms after its stimulus; the deadline is 0.1 s" in faults[0].detail

    run(main, virtual=True)


def test_messages_are_published_action_first():
    async def main(runtime):
        robot = ensemble()
        order = []
        for name, kind in (("action", Action), ("reward", Reward), ("belief", Belief)):
            runtime.channel(f"robot/{name}", kind, retain=name != "action").subscribe(
                lambda message, name=name: order.append((name, message.time))
            )
        await runtime.start(robot)
        assert [name for name, _ in order] == ["action", "reward", "belief"]
        assert {time for _, time in order} == {0}

    run_virtual(main)


def ring(size=6000):
    """Walk on by one or two places, and hear whether the place is odd; a belief is in few states for long."""
    from scipy.sparse import csr_array

    states = np.arange(size)
    rows = np.repeat(states, 2)
    columns = (rows + np.tile([1, 2], size)) % size
    slow, fast = (
        csr_array((np.tile(chances, size), (rows, columns)), shape=(size, size))
        for chances in ([0.75, 0.25], [0.25, 0.75])
    )
    told = np.full((size, 2), 0.1)
    told[states, states % 2] = 0.9
    return POMDP(
        [slow, fast],
        [csr_array(told)] * 2,
        np.stack([np.sin(states), np.cos(states)], axis=1),
        discount=0.9,
        initial_belief=np.eye(1, size, 7)[0],
        sparse=True,
    )


def by_array(model, policy):
    """The same policy, which takes arrays alone."""

    class ByArray(BeliefPolicy):
        num_states, num_actions = policy.num_states, policy.num_actions

        def action(self, belief):
            assert isinstance(belief, np.ndarray)
            return policy.action(belief)

    return ByArray()


def test_decisions_by_the_support_of_a_belief_are_those_by_its_array():
    model = ring()
    random = np.random.default_rng(3)
    policy = AlphaVectors(random.normal(size=(9, len(model.state_space))), [0, 1, 0, 1, 0, 1, 0, 1, 0], 2)
    script = [see(o) for o in random.integers(2, size=25).tolist()]
    options = {"model": model, "actions": dict.fromkeys(range(2), nothing)}
    found, _, _ = decided(script, policy=policy, **options)
    expected, _, _ = decided(script, policy=by_array(model, policy), **options)
    assert len(found) == 26
    assert {decision.action for decision in found} == {0, 1}
    for one, other in zip(found, expected, strict=True):
        assert (one.action, one.epoch, one.cause) == (other.action, other.epoch, other.cause)
        assert one.reward == pytest.approx(other.reward, abs=1e-12)
        np.testing.assert_allclose(one.belief, other.belief, atol=1e-12)


def test_no_array_of_a_sparse_belief_is_made_unless_somebody_listens(monkeypatch):
    model = ring()
    policy = AlphaVectors(np.zeros((2, len(model.state_space))), [0, 1])
    asked = []
    belief_of = BeliefTracker.belief.fget
    monkeypatch.setattr(BeliefTracker, "belief", property(lambda self: asked.append(self) or belief_of(self)))

    async def main(runtime):
        robot = Ensemble("robot", policy=policy, model=model, actions=dict.fromkeys(range(2), nothing))
        rewards = probe(runtime.channel("robot/reward", Reward, retain=True))
        await runtime.start(robot)
        for observation in (0, 1, 0):
            robot.publish_observation(observation)
        assert asked == []
        assert len(rewards) == 4
        expected = BeliefTracker(model)
        for observation in (0, 1, 0):
            expected.update(0, observation)
        channel = runtime.channel("robot/belief", Belief, retain=True)
        beliefs = probe(channel)  # comes late: told of the last one
        np.testing.assert_allclose(beliefs[-1].probabilities, belief_of(expected), atol=1e-15)
        assert asked == []
        robot.publish_observation(1)
        expected.update(0, 1)
        np.testing.assert_allclose(beliefs[-1].probabilities, belief_of(expected), atol=1e-15)
        assert (len(beliefs), channel.published, len(asked)) == (2, 5, 1)
        assert rewards[-1].value == pytest.approx(model.rewards[:, 0] @ belief_of(expected))

    run_virtual(main)

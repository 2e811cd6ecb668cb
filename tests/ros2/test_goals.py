"""Goals of an action's server, over a wire in plain Python and in virtual time."""

from __future__ import annotations

import asyncio

import pytest
from action_lives import lives_of, robot, told
from hypothesis import example, given, settings, strategies as st
from ros2.stand_in import Behaviour, Server, StandIn
from sentences import refused

from mdm.errors import Error
from mdm.messages import Fault
from mdm.ros2.actions import Actions
from mdm.testing import probe, run_virtual

KIND = "nav2_msgs/action/DockRobot"
OTHER, DOCK, AGAIN, THIRD = range(4)


class Bench:
    """A robot with two actions at the server ``/dock`` and one at ``/lift``; states are the actions to decide on."""

    def __init__(self, runtime, *, silence=None, group=None, safe=True, may_succeed=None, **server):
        self.runtime = runtime
        self.wire = StandIn()
        self.server = Server(self.wire, "/dock", **server)
        self.lift = Server(self.wire, "/lift")
        self.actions = Actions(self.wire)
        self.fed = []
        self.safe_runs = []

        def goal(name, **options):
            return self.actions.goal(name, KIND, goal=self.made, feedback=self.fed.append, silence=silence, **options)

        def own():
            equal = group and f"{group[0]}{group[1:]}"  # groups are the same by what they are called
            return {"group": equal, **({} if may_succeed is None else {"may_succeed": may_succeed})}

        self.robot = robot(
            {
                "Other": lambda: None,
                "Dock": goal("/dock", **own()),
                "Again": goal("/dock", **own()),
                "Lift": goal("/lift"),
            },
            **({"safe_action": self.secure} if safe else {}),
            on_failed_action="safe" if safe else "continue",
        )
        self.lives = lives_of(runtime)
        self.faults = probe(runtime.channel("faults", Fault))

    def secure(self):
        self.safe_runs.append(self.now())

    def made(self):
        return {"dock_id": str(self.robot.action.lives.current.number)}

    def now(self):
        return asyncio.get_running_loop().time()

    async def start(self):
        await self.wire.open(self.runtime)
        await self.actions.open(self.runtime)
        await self.runtime.start(self.robot)

    def decide(self, index):
        self.robot.publish_state(index)

    @property
    def goals(self):
        """The goals of the server, those before it was started again among them."""
        return self.server.goals

    def told(self):
        """Return the lives of actions, but of the safe one, as they were told."""
        return told(life for life in self.lives if life.action != "safe action")

    def details(self):
        return [life.detail for life in self.lives if life.status != "running" and life.action != "safe action"]


def bench(scenario, **options):
    async def main(runtime):
        made = Bench(runtime, **options)
        await made.start()
        await scenario(made)
        await made.actions.close()

    run_virtual(main, log=False)


# -- Ends ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("behaviour", "status", "words"),
    [
        ({"takes": 2.0}, "succeeded", ""),
        ({"accepts": False}, "failed", "Error: the server of /dock rejected the goal"),
        (
            {"takes": 2.0, "ends": 5},
            "failed",
            "Error: the server of /dock cancelled the goal (status 5), as somebody else asked",
        ),
        ({"takes": 2.0, "ends": 6}, "failed", "Error: the server of /dock aborted the goal (status 6)"),
        (
            {"takes": 2.0, "ends": 6, "result": {"error_code": 902, "error_msg": "no dock", "success": False}},
            "failed",
            "Error: the server of /dock aborted the goal (status 6): error_code 902, error_msg 'no dock'",
        ),
        (
            {"takes": 2.0, "ends": 6, "result": {"error_code": 0, "error_msg": ""}},
            "failed",
            "Error: the server of /dock aborted the goal (status 6)",
        ),
    ],
)
def test_a_goal_ends_as_its_server_says(behaviour, status, words):
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(3)
        assert bench.told()[:2] == [("Dock", "running"), ("Dock", status)]
        assert bench.details()[0].startswith(words)

    bench(scenario, **behaviour)


def test_a_goal_that_is_pre_empted_ends_before_the_next_action_begins():
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(3)
        bench.decide(AGAIN)
        await asyncio.sleep(1.5)
        assert bench.told() == [("Dock", "running")]
        await asyncio.sleep(0.2)
        assert bench.told() == [("Dock", "running"), ("Dock", "preempted"), ("Again", "running")]
        assert [goal.status for goal in bench.goals] == [5, None]
        assert bench.server.most == 1

    bench(scenario, brakes=1.6)


ASKED = "the server of /dock was asked to cancel the goal, and "
PRE_EMPTED = {
    "aborted": ({"cancelled": 6}, 1, 1, "failed", f"Error: {ASKED}aborted the goal (status 6)"),
    "reached": ({"cancelled": 4}, 1, 1, "succeeded", ""),
    "reached, and may not": ({"cancelled": 4, "may_succeed": False}, 1, 1, "preempted", ""),
    "answered later": ({"answers": 3.0}, 1, 2.1, "preempted", ""),
    "rejected later": ({"answers": 3.0, "accepts": False}, 1, 3, "preempted", ""),
    "braking beyond its silence": ({"silence": 0.5, "feeds": 0.3, "brakes": 3.0}, 1, 5, "preempted", ""),
}


@pytest.mark.parametrize("name", PRE_EMPTED)
def test_a_goal_that_is_cancelled_ends_as_its_server_says(name):
    options, before, after, status, words = PRE_EMPTED[name]

    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(before)
        bench.decide(OTHER)
        if name == "answered later":
            await asyncio.sleep(1)
            assert (bench.goals[0].accepted, bench.told()) == (None, [("Dock", "running")])
        await asyncio.sleep(after)
        assert bench.told()[1:] == [("Dock", status), ("Other", "running"), ("Other", "succeeded")]
        assert bench.details()[0].startswith(words)
        assert bench.robot.mode == "deciding"
        if name == "answered later":
            assert (bench.goals[0].accepted, bench.goals[0].cancels, bench.goals[0].status) == (True, 1, 5)

    bench(scenario, **options)


def test_a_server_that_comes_later_is_waited_for_and_told():
    async def scenario(bench):
        server = bench.wire.servers.pop("/dock")
        bench.decide(DOCK)
        await asyncio.sleep(4)
        assert bench.told() == [("Dock", "running")]
        assert [(fault.source, fault.kind, fault.detail) for fault in bench.faults] == [
            ("ros2/dock", "unmatched", "the server of /dock is not there: an action waits for it")
        ]
        bench.wire.servers["/dock"] = server
        await asyncio.sleep(2)
        assert bench.told()[1:] == [("Dock", "succeeded")]
        assert bench.fed

    bench(scenario, takes=1.0, feeds=0.4)


def test_what_waits_for_a_server_ends_at_once_when_it_is_pre_empted():
    async def scenario(bench):
        del bench.wire.servers["/dock"]
        bench.decide(DOCK)
        await asyncio.sleep(4)
        bench.decide(THIRD)
        await asyncio.sleep(0)
        await asyncio.sleep(0.01)
        assert bench.told() == [("Dock", "running"), ("Dock", "preempted"), ("Lift", "running")]

    bench(scenario)


# -- Silence ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("silence", [2.0, 0.5])
@pytest.mark.parametrize("state", ["absent", "sent", "accepted", "feeding"])
def test_a_goal_of_a_silent_server_has_failed(state, silence):
    async def scenario(bench):
        if state == "absent":
            del bench.wire.servers["/dock"]
        elif state == "sent":
            bench.server.hold()
        bench.decide(DOCK)
        begin = bench.now()
        if state == "feeding":
            await asyncio.sleep(2.1)
            assert len(bench.fed) == 7
            begin += 2.1
        if state in {"feeding", "accepted"}:
            await asyncio.sleep(0)
            await asyncio.sleep(0.001)
            bench.server.hold()
        await asyncio.sleep(silence - 0.31)
        assert bench.told() == [("Dock", "running")]
        await asyncio.sleep(0.32)
        assert bench.told()[1:2] == [("Dock", "failed")]
        words = "was not there for" if state == "absent" else "told nothing for"
        assert f"the server of /dock {words} {silence:g} s" in bench.details()[0]
        assert bench.robot.mode == "safe"
        assert len(bench.safe_runs) == 1
        assert bench.safe_runs[0] - begin <= silence + 0.01

    bench(scenario, silence=silence, feeds=0.3)


@pytest.mark.parametrize("silence", [2.0, 0.5])
@pytest.mark.parametrize("group", [None, "wheels"])
def test_cancelling_a_silent_server_waits_no_longer_than_its_silence_and_the_safe_action_runs(silence, group):
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(0.35)
        bench.server.hold()
        await asyncio.sleep(0.1)
        begin = bench.now()
        bench.decide(THIRD)
        await asyncio.sleep(silence + 0.001)
        assert bench.told()[1] == ("Dock", "abandoned")
        assert "was asked to cancel the goal, and told nothing" in bench.details()[0]
        assert bench.safe_runs == [pytest.approx(begin + silence)]
        await asyncio.sleep(0.01)
        assert bench.robot.mode == "deciding"
        assert bench.told()[2] == ("Lift", "running")

    bench(scenario, silence=silence, feeds=0.3, group=group)


def test_a_server_that_is_heard_after_it_was_asked_to_cancel_has_its_silence_from_then():
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(0.35)
        bench.server.hold()
        await asyncio.sleep(1.7)
        bench.decide(OTHER)
        await asyncio.sleep(1.0)  # 2.7 s after it was last heard
        bench.server.wake()
        await asyncio.sleep(0.1)
        assert bench.told()[1] == ("Dock", "preempted")

    bench(scenario, silence=2.0, feeds=0.3)


# -- Older goals -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("server", ["held", "gone", "started again"])
def test_no_goal_is_sent_beside_one_whose_end_was_not_heard_until_it_is(server):
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(1)
        bench.server.hold() if server == "held" else bench.server.vanish()
        await asyncio.sleep(2)
        assert bench.told()[1:] == [("Dock", "failed")]
        served = bench.server.start_again() if server == "started again" else bench.server
        bench.decide(AGAIN)
        await asyncio.sleep(0.001)
        assert bench.told()[2:] == [("Again", "running"), ("Again", "failed")]
        assert "the server of /dock may go on with an older goal, whose end was not heard" in bench.details()[1]
        if server == "held":
            bench.server.wake()
            await asyncio.sleep(2)
            assert bench.goals[0].status == 5
        else:
            served = bench.server.start_again() if server == "gone" else served
            await asyncio.sleep(7)  # which asks for the old goal meanwhile: nobody knows it
        bench.decide(DOCK)
        await asyncio.sleep(1)
        assert bench.told()[4:] == [("Dock", "running")]
        assert (len(served.goals), served.most) == (2 if server == "held" else 1, 1)

    bench(scenario, silence=1.0, feeds=0.3, safe=False)


def test_a_goal_is_sent_beside_one_whose_end_was_not_heard_when_the_safe_action_has_run():
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(1)
        bench.server.hold()
        await asyncio.sleep(2)
        assert (bench.robot.mode, len(bench.safe_runs)) == ("safe", 1)
        bench.decide(AGAIN)
        bench.robot.release()
        await asyncio.sleep(0.5)
        assert bench.told()[-1] == ("Again", "running")
        bench.server.wake()
        await asyncio.sleep(2)
        assert [goal.status for goal in bench.goals] == [5, None]
        assert bench.told()[-1] == ("Again", "running")

    bench(scenario, silence=1.0, feeds=0.3)


def test_beside_two_goals_whose_ends_were_not_heard_no_third_is_sent():
    async def scenario(bench):
        bench.server.hold()
        for action, sent in ((DOCK, 1), (AGAIN, 2), (DOCK, 2)):
            bench.decide(action)
            bench.robot.release()
            await asyncio.sleep(2)
            assert (bench.robot.mode, len(bench.server.sent)) == ("safe", sent)
        assert "may go on with two older goals" in bench.details()[-1]
        ours = bench.actions.server("/dock", KIND)
        safe = pursue(ours, bench, silence=1.0, secures=True)
        await asyncio.sleep(0.1)
        assert len(bench.server.sent) == 3  # the safe action's own is sent all the same
        bench.server.wake()
        await asyncio.sleep(6)
        safe.cancel()
        await asyncio.sleep(4)
        assert [goal.status for goal in bench.goals] == [5, 5, 5]
        bench.decide(AGAIN)
        bench.robot.release()
        await asyncio.sleep(0.5)
        assert bench.told()[-1] == ("Again", "running")

    bench(scenario, silence=1.0, feeds=0.3, brakes=3.0)


@pytest.mark.parametrize("feeds", [0.3, None])
def test_no_goal_is_sent_beside_one_that_goes_on_though_the_safe_action_has_run(feeds):
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(1)
        bench.robot.safety.endanger("mine", "", bench.runtime.now())
        await asyncio.sleep(6)
        assert bench.told()[1:] == [("Dock", "abandoned")]
        assert len(bench.safe_runs) == 1
        bench.decide(AGAIN)
        bench.robot.release()
        await asyncio.sleep(1)
        assert bench.told()[2:4] == [("Again", "running"), ("Again", "failed")]
        assert len(bench.server.sent) == 1

    bench(scenario, feeds=feeds, brakes=None)


def test_a_server_that_wakes_with_an_old_goal_is_asked_again_to_cancel_it():
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(1)
        bench.server.hold()
        await asyncio.sleep(20)
        bench.server.lose()  # the middleware gave it up meanwhile: what was sent is lost
        bench.server.wake()
        await asyncio.sleep(0.4)
        assert (bench.goals[0].cancels, bench.goals[0].status) == (1, 5)

    bench(scenario, silence=1.0, feeds=0.3, safe=False)


@pytest.mark.parametrize("silence", [1.0, None])
def test_a_goal_whose_request_was_lost_is_given_up_when_its_server_does_not_know_it(silence):
    async def scenario(bench):
        bench.server.hold()
        bench.decide(DOCK)
        await asyncio.sleep(1.5)
        bench.server.lose()
        bench.server.wake()
        bench.decide(AGAIN)
        await asyncio.sleep(8)
        bench.decide(AGAIN)
        await asyncio.sleep(1)
        assert "may go on with an older goal, whose end was not heard" in bench.details()[-1]
        assert len(bench.server.sent) == 1
        await asyncio.sleep(12)
        bench.decide(DOCK)
        await asyncio.sleep(1)
        assert bench.told()[-1] == ("Dock", "running")
        assert len(bench.goals) == 1

    bench(scenario, silence=silence, feeds=0.3, safe=False)


def test_a_server_that_is_not_heard_is_asked_to_cancel_as_soon_as_its_goal_has_failed():
    async def scenario(bench):
        bench.server.next = [Behaviour(mute=True)]
        bench.decide(DOCK)
        await asyncio.sleep(0.9)
        assert bench.server.live == bench.goals
        await asyncio.sleep(0.2)
        assert bench.told()[-1] == ("Dock", "failed")
        assert (bench.goals[0].cancels, bench.server.live) == (1, [])

    bench(scenario, silence=1.0, feeds=0.3, safe=False)


def test_a_goal_that_was_given_up_is_cancelled_when_its_server_answers_after_all():
    async def scenario(bench):
        bench.server.next = [Behaviour(answers=30.0, feeds=0.3, brakes=2.0)]
        bench.decide(DOCK)
        await asyncio.sleep(20)
        bench.decide(AGAIN)
        await asyncio.sleep(1)
        assert [goal.accepted for goal in bench.goals] == [None, True]
        assert bench.told()[-1] == ("Again", "running")
        bench.decide(OTHER)
        await asyncio.sleep(10)
        assert (bench.goals[0].accepted, bench.goals[0].cancels, bench.server.live) == (True, 1, [bench.goals[0]])
        bench.decide(DOCK)
        await asyncio.sleep(0.1)
        assert "may go on with an older goal" in bench.details()[-1]
        await asyncio.sleep(2)
        bench.decide(AGAIN)
        await asyncio.sleep(0.1)
        assert bench.told()[-1] == ("Again", "running")

    bench(scenario, silence=1.0, feeds=0.3, safe=False)


def test_a_goal_that_ends_without_a_result_has_ended():
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(1)
        bench.goals[0].tell(4)  # and the result is lost
        await asyncio.sleep(1.1)
        assert bench.told()[1:] == [("Dock", "succeeded")]

    bench(scenario)


def test_another_action_of_a_server_that_pursues_a_goal_fails():
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(1)
        bench.decide(AGAIN)
        await asyncio.sleep(6)  # the grace is over: the first one is abandoned, and its server ignores that
        assert bench.told()[1:2] == [("Dock", "abandoned")]
        bench.decide(AGAIN)
        await asyncio.sleep(1)
        assert bench.server.most == 1

    bench(scenario, brakes=None, feeds=0.3, safe=False)


@pytest.mark.parametrize("feeds", [None, 0.1])
def test_a_server_that_ignores_cancellations_is_asked_now_and_then(feeds):
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(1)
        bench.decide(OTHER)
        await asyncio.sleep(60)
        assert bench.goals[0].cancels == pytest.approx(60 if feeds else 12, abs=5)

    bench(scenario, brakes=None, feeds=feeds)


# -- Groups ----------------------------------------------------------------------------------------------------------


def test_of_a_group_the_new_goal_is_sent_first_and_the_old_one_is_not_cancelled():
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(1)
        bench.decide(AGAIN)
        await asyncio.sleep(2)
        assert [(goal.status, goal.cancels) for goal in bench.goals] == [(6, 0), (None, 0)]
        assert bench.told() == [("Dock", "running"), ("Dock", "preempted"), ("Again", "running")]
        assert not bench.faults
        bench.decide(OTHER)
        await asyncio.sleep(1)
        assert [(goal.status, goal.cancels) for goal in bench.goals] == [(6, 0), (5, 1)]

    bench(scenario, group="wheels", replaces=True, answers=0.3)


@pytest.mark.parametrize("replaces", [True, False])
def test_of_a_group_the_old_goal_ends_where_the_new_one_is_rejected_or_replaces_none(replaces):
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(1)
        if replaces:
            bench.server.behaviour.accepts = False
        bench.decide(AGAIN)
        await asyncio.sleep(2)
        assert (bench.goals[0].status, bench.goals[0].cancels) == (5, 1)
        assert bench.told()[1] == ("Dock", "preempted")

    bench(scenario, group="wheels", replaces=replaces, answers=0.3)


def test_of_a_group_no_goal_is_sent_to_a_silent_server():
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(0.35)
        bench.server.hold()
        await asyncio.sleep(0.1)
        bench.decide(AGAIN)  # it is not known yet that the server is silent
        await asyncio.sleep(2.1)
        assert bench.told()[1:] == [("Dock", "preempted"), ("Again", "running"), ("Again", "failed")]
        times = [(round(fault.time / 1e9 - 0.45, 3), fault.detail[:20]) for fault in bench.faults]
        assert sorted(times) == [(2.0, "action 'Again' faile"), (2.0, "action 'Dock', which")]
        bench.decide(DOCK)
        await asyncio.sleep(0.1)
        assert bench.told()[4:] == [("Dock", "running"), ("Dock", "failed")]
        assert len(bench.server.sent) == 2

    bench(scenario, group="wheels", replaces=True, feeds=0.3, silence=2.0, safe=False)


def test_of_a_group_a_chain_of_goals_leaves_the_last():
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(1)
        for index in (AGAIN, DOCK, AGAIN):
            bench.decide(index)
            await asyncio.sleep(0.1)
        await asyncio.sleep(3)
        assert [goal.status for goal in bench.goals] == [6, 6, 6, None]
        assert [goal.cancels for goal in bench.goals] == [0, 0, 0, 0]

    bench(scenario, group="wheels", replaces=True, answers=0.25)


def watched(bench, servers):
    """Hold the rules against all that was sent and told."""
    assert all(server.most <= 2 for server in servers)
    goals = {goal.message.dock_id: goal for server in (*servers, bench.lift) for goal in server.sent}
    for goal in goals.values():
        for other, heard in goal.beside:
            known = heard if heard < goal.sent else 0  # news of this very instant were on their way
            ran = any(known <= time <= goal.sent for time in bench.safe_runs)
            assert ran, f"goal {goal.message.dock_id} was sent beside {other.message.dock_id}"
    lives = {}
    for life in bench.lives:
        lives.setdefault(life.life, []).append(life)
    for number, (begin, *ends) in lives.items():
        assert begin.status == "running"
        assert len(ends) == 1, f"{begin.action} has {len(ends)} ends"
        if begin.action not in {"Other", "safe action"}:
            fits(ends[0], goals.get(str(number)))


def fits(end, goal):
    """Hold an end that was told against the goal, as its server has it."""
    unsent = goal is None or goal.accepted is False
    match end.status:
        case "succeeded":
            assert goal.status == 4
        case "preempted":
            assert unsent or goal.status == 5
        case "failed":
            for words, status in (("aborted", 6), ("cancelled the goal", 5)):
                assert (words in end.detail) == (goal is not None and words in end.detail and goal.status == status)
            for words in ("not be sent", "may go on", "another action", "was not there"):
                assert words not in end.detail or goal is None
            assert "rejected" not in end.detail or goal.accepted is False
            assert goal is None or goal.status != 4 or "told nothing" in end.detail
            assert goal is not None or "told nothing" not in end.detail
        case "abandoned":
            assert goal is not None


# -- Beside each other -----------------------------------------------------------------------------------------------


def pursue(server, bench, **options):
    given = {"silence": None, "group": None, "secured": lambda: 0, **options}
    return asyncio.create_task(server.pursue(bench.wire.make(KIND), bench.fed.append, **given))


@pytest.mark.parametrize("later", [True, False])
def test_of_two_actions_of_a_server_one_is_sent(later):
    async def scenario(bench):
        ours = bench.actions.server("/dock", KIND)
        if later:  # both wait for it
            server = bench.wire.servers.pop("/dock")
        one = pursue(ours, bench)
        await asyncio.sleep(0.01)
        two = pursue(ours, bench)
        if later:
            await asyncio.sleep(1)
            bench.wire.servers["/dock"] = server
        await asyncio.sleep(0.5)
        (done,), (other,) = await asyncio.wait([one, two], return_when=asyncio.FIRST_COMPLETED)
        with refused(Error):
            await done
        assert len(bench.server.sent) == 1
        other.cancel()
        await asyncio.wait([other])
        assert other.cancelled()

    bench(scenario)


def test_of_a_group_the_old_one_ends_when_its_server_has_ended_it():
    async def scenario(bench):
        ours = bench.actions.server("/dock", KIND)
        one = pursue(ours, bench, group="wheels")
        await asyncio.sleep(1)
        two = pursue(ours, bench, group="wheels")
        await asyncio.sleep(0)
        one.cancel()
        await asyncio.wait([one], timeout=0.5)
        assert one.cancelled()
        bench.server.behaviour.cancelled = 4
        two.cancel()
        await two  # it has succeeded all the same

    bench(scenario, replaces=True, answers=0.2)


def test_feedback_of_a_goal_that_was_asked_to_end_is_not_told():
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(1)
        count = len(bench.fed)
        bench.decide(OTHER)
        await asyncio.sleep(3)
        assert (count, len(bench.fed), bench.goals[0].fed) == (3, 3, 9)

    bench(scenario, feeds=0.3, brakes=2.0)


# -- Random schedules ------------------------------------------------------------------------------------------------

seconds = st.sampled_from([0.0, 0.001, 0.1, 0.3, 0.999, 1.0, 1.7, 4.9, 5.0, 7.0])
steps = st.one_of(
    st.tuples(st.just("decide"), st.sampled_from([OTHER, DOCK, AGAIN, THIRD])),
    st.tuples(st.just("sleep"), seconds),
    st.tuples(st.just("end"), st.sampled_from([4, 5, 6])),
    st.sampled_from([("hold",), ("wake",), ("lose",), ("again",), ("release",), ("endanger",)]),
)
behaviours = st.fixed_dictionaries(
    {},
    optional={
        "accepts": st.just(False),
        "answers": seconds,
        "takes": seconds,
        "ends": st.sampled_from([4, 5, 6]),
        "feeds": st.sampled_from([0.1, 0.7]),
        "brakes": st.one_of(st.none(), seconds),
        "cancelled": st.sampled_from([4, 6]),
    },
)


@settings(max_examples=100, deadline=None)
@given(
    schedule=st.lists(steps, max_size=14), served=st.lists(behaviours, max_size=6), silence=st.sampled_from([None, 2.0])
)
@example([("decide", DOCK), ("decide", AGAIN), ("decide", THIRD)], [{"answers": 1.7}, {"answers": 0.3}], None)
def test_of_a_group_one_goal_drives_at_most_when_all_is_quiet(schedule, served, silence):
    async def scenario(bench):
        bench.server.next = [  # which answer and brake within an action's grace
            Behaviour(**{**each, "brakes": 0.0, "answers": min(each.get("answers", 0.0), 1.7)}) for each in served
        ]
        for step, *what in schedule:
            match step:
                case "decide":
                    bench.decide(*what)
                case "sleep":
                    await asyncio.sleep(*what)
                case "end":
                    for goal in bench.server.live:
                        goal.end(*what)
        await asyncio.sleep(30)
        running = [life.action for life in bench.lives][-1:] if bench.robot.action.live else []
        assert len(bench.server.live) == sum(action in {"Dock", "Again"} for action in running)
        bench.decide(OTHER)
        await asyncio.sleep(30)
        assert not bench.server.live
        assert all(life.status not in {"timed_out", "abandoned"} for life in bench.lives)

    bench(scenario, silence=silence, group="wheels", replaces=True, safe=False)


@pytest.mark.parametrize(("ends", "status"), [(6, "failed"), (4, "succeeded"), (5, "preempted")])
def test_a_goal_that_ends_by_itself_in_the_moment_of_its_cancellation_ends_so(ends, status):
    async def scenario(bench):
        bench.decide(DOCK)
        await asyncio.sleep(1)
        bench.goals[0].end(ends)
        await asyncio.sleep(0)
        bench.decide(OTHER)
        await asyncio.sleep(0.1)
        assert bench.told()[1] == ("Dock", status)

    bench(scenario, safe=False)


def hold_the_rules(schedule, served, silence, safe):
    async def scenario(bench):
        servers = [bench.server]
        bench.server.next = [Behaviour(**given) for given in served]
        for step, *what in schedule:
            server = servers[-1]
            match step:
                case "decide":
                    bench.decide(*what)
                case "sleep":
                    await asyncio.sleep(*what)
                case "end":
                    for goal in server.live if not server.held else ():
                        goal.end(*what)
                case "hold":
                    server.hold()
                case "wake":
                    server.wake()
                case "lose":
                    server.lose()
                case "again":
                    server.vanish()
                    servers.append(server.start_again())
                case "release":
                    bench.robot.release()
                case "endanger":
                    bench.robot.safety.endanger("mine", "", bench.runtime.now())
        servers[-1].wake()
        await asyncio.sleep(60)
        bench.decide(OTHER)
        await asyncio.sleep(60)
        watched(bench, servers)

    bench(scenario, silence=silence, safe=safe)


drawn = given(
    schedule=st.lists(steps, max_size=14),
    served=st.lists(behaviours, max_size=6),
    silence=st.sampled_from([None, 0.5, 2.0]),
    safe=st.booleans(),
)
LOST = [step for action in (DOCK, AGAIN, DOCK) for step in (("decide", action), ("release",), ("sleep", 4.9))]


@settings(max_examples=200, deadline=None)
@drawn
@example([("hold",), *LOST, ("wake",), ("sleep", 7.0)], [{"brakes": 7.0}] * 3, 2.0, True)
def test_never_two_goals_of_a_server_are_live_and_each_ends_once(schedule, served, silence, safe):
    hold_the_rules(schedule, served, silence, safe)


@pytest.mark.slow
@settings(max_examples=3000, deadline=None)
@drawn
@example([("decide", 1), ("hold",), ("sleep", 0.999), ("decide", 1)], [], 0.5, True)
def test_never_two_goals_are_live_in_thousands_of_schedules(schedule, served, silence, safe):
    hold_the_rules(schedule, served, silence, safe)

"""Sources: where a control layer's input comes from, its ensemble's own channels or a team.

A layer that decides for itself stops deciding while its ensemble is safe. One of a team has a copy of a process that
all agents decide on: it goes on deciding in safe modes, as they do, but its decisions are not carried out.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeVar

import msgspec

from mdm.actors.control.output import symbol_of
from mdm.actors.safety.modes import AT_INPUT, AT_KNOWN, AT_STIMULUS
from mdm.errors import Error, ModelError
from mdm.messages import Belief, Control, Observation, State
from mdm.runtime.supervision import text_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.actors.control.control_layer import ControlLayer
    from mdm.actors.control.output import Observed
    from mdm.controller import Controller, Step
    from mdm.messages import Action, Tick
    from mdm.models.matrices import Vector
    from mdm.runtime import Channel

T = TypeVar("T")

_opened = msgspec.msgpack.Decoder(tuple[bytes, bool, int | None, int | None]).decode
"""The parts of a snapshot: that of the controller, whether it runs, the state, and the action that was published."""

CommandName = Literal["start", "stop", "reset", "resume"]


class Team(Protocol):
    """Receives the requests to an ensemble that is of a team."""

    def command(self, command: CommandName) -> None:
        """Somebody asks the ensemble for this here: it concerns the whole team."""

    @property
    def absence(self) -> str:
        """Who is not there whose factors are unknown, and what to do, in words; empty where nobody is."""

    @property
    def period(self) -> float | None:
        """Seconds from one joint step to the next; None where events make the steps."""


class Held(Enum):
    """How a safe mode of the ensemble holds its input, and what the belief knows of it.

    Attributes:
        NOT: There is none: input is decided on, or the ensemble is stopped.
        BLINDLY: The belief does not know the action that is done.
        KNOWING: It knows that one.
        MOVED: It knows that one, and has gone by an observation since.
    """

    NOT = "not"
    BLINDLY = "blindly"
    KNOWING = "knowing"
    MOVED = "moved"


class OwnChannels:
    """The channels of the layer's ensemble: nothing is decided while that is safe.

    Args:
        control: The layer.

    Attributes:
        shared: Whether other agents decide on the same.
        catching_up: Whether it repeats decisions that others made long ago, so that none is carried out.
        absence: Who is not there whose factors of the state are unknown, and what to do, in words; empty where nobody
            is.
    """

    shared = catching_up = False
    absence = ""

    def __init__(self, control: ControlLayer) -> None:
        self._held = Held.NOT
        self._control = control
        self._unanswered: tuple[str, Observed] = ("release", None)

    def open(self) -> None:
        """Subscribe to its input, and to commands."""
        control, channel = self._control, self._control.owner.channel
        self._held = Held.NOT
        if control.takes_states:
            self._listen(channel("state", State, retain=True), control.on_state)
        else:
            self._listen(channel("observation", Observation), control.on_observation)
            self._listen(channel("external_belief", Belief), self._on_external_belief)
            self._listen(channel("initial_belief", Belief, retain=True), self._on_initial_belief)
        self._listen(channel("control", Control), control.on_control)

    def _listen(self, channel: Channel[T], handler: Callable[[T], object]) -> None:
        channel.input = True
        self._control.subscribe(channel, handler)

    @property
    def held(self) -> bool:
        """Whether input is decided on only when a safe mode is over; nothing is decided then."""
        return self._held is not Held.NOT

    def asked(self, command: CommandName) -> bool:
        """Return that it concerns this ensemble alone."""
        return False

    @property
    def may_begin(self) -> bool:
        """Whether the ensemble decides, or will when its safe mode is over."""
        guard = self._control.guard
        return guard is None or guard.deciding or guard.returning

    @property
    def may_decide(self) -> bool:
        """Whether the ensemble decides."""
        guard = self._control.guard
        return guard is None or guard.deciding

    def hold(self, done: int | None) -> None:
        """Decide nothing until the safe mode is over.

        Args:
            done: The safe action, where it is one of the model's: the belief then goes by it.
        """
        control = self._control
        control.running = False
        control.withdraw()
        self._held = Held.BLINDLY if done is None or control.takes_states else Held.KNOWING
        self._unanswered = ("release", None)
        if done is not None:
            if control.decided[0] != control.controller.epoch:  # else this is another run of the safe action
                control.decided = control.controller.epoch, control.output.acted
            control.controller.last_action = control.output.acted = done

    def let_go(self) -> None:
        """Decide nothing more."""
        self._control.running = False
        self._held = Held.NOT

    def latch(self) -> None:
        """Decide nothing more; observations of a safe mode are taken in until that is over."""
        self._control.running = False

    def go_on(self, time: int, *, restart: bool, predict: bool) -> None:
        """Decide on the input known now: a safe mode is over.

        Args:
            time: When.
            restart: Begin a new episode: the effect of the safe action on the state is unknown.
            predict: Time has passed, of which the belief does not know.
        """
        control = self._control
        moved = self._held is Held.MOVED
        self._held, control.running = Held.NOT, True
        controller = control.controller
        if not control.takes_states:
            if (restart and not controller.given) or controller.over:
                control.begin_episode()
                self._unanswered = ("release", None)
            elif predict and control.event_driven and not moved:
                control.advance(None, time)
        if control.running and control.event_driven and not control.blind:
            cause, observation = self._unanswered
            control.decide(time, cause, observation)

    def decide_again(self, time: int) -> bool:
        """Decide, where inputs alone have it decide; return whether that is one decision more of the episode."""
        control = self._control
        asked = control.asking is not None and control.asking.stimulus is not None
        if asked or not control.running or not control.event_driven or control.blind:
            return False
        over = control.controller.over
        if over:
            control.begin_episode()
        control.decide(time, "episode" if over else "again")
        return not over

    def _on_external_belief(self, belief: Belief) -> None:
        """Decide on a belief from outside, in place of the layer's own."""
        control = self._control
        if not control.running and not self.held:
            return
        over = control.controller.over
        if not self._took(control.controller.believe, "external_belief", belief):
            return
        control.ticks.kept()  # an observation from before it
        if self.held:
            control.reopen(AT_INPUT, belief.time)
        elif control.event_driven:
            control.decide(belief.time, "episode" if over else "belief")
        elif control.asking is not None:
            control.asking.ask_anew()

    def _on_initial_belief(self, belief: Belief) -> None:
        """Take a belief as that from which the next episode begins."""
        self._took(self._control.controller.begin_from, "initial_belief", belief)

    def _took(self, take: Callable[[Vector], object], channel: str, belief: Belief) -> bool:
        """Give the controller a belief; report one that it refuses."""
        try:
            take(belief.probabilities)
        except (Error, ValueError, TypeError) as error:
            control = self._control
            text = f"refused a belief on {control.owner.path}/{channel}: {text_of(error)}"
            control.report("belief", text, time=belief.time)
            return False
        return True

    def observe_aside(self, observation: Observation) -> None:
        """Take an observation in while the ensemble is safe: into the belief, where that knows the action done."""
        if not self.held:
            return
        control = self._control
        if not control.event_driven:
            control.ticks.keep(observation, counts=False)
        elif self._held is not Held.BLINDLY and not control.controller.over:
            self._held = Held.MOVED
            control.advance(symbol_of(observation), observation.time)
        control.reopen(AT_INPUT, observation.time)

    def tick_aside(self, tick: Tick) -> None:
        """Let the belief go by a tick while the ensemble is safe, unless the tick ends that."""
        control = self._control
        control.reopen(AT_STIMULUS, tick.time)
        if not control.running and self._held in {Held.KNOWING, Held.MOVED} and not control.controller.over:
            observation = control.ticks.kept()
            control.ticks.advance(None if observation is None else symbol_of(observation), tick.time)

    def answer_later(self, cause: str, observation: Observed) -> None:
        """Keep the stimulus that the next decision answers."""
        self._unanswered = (cause, observation)


class JointProcess:
    """One agent's copy of a process on which a team decides: the team calls it, in the call in which it has decided.

    Args:
        control: The layer.
        team: Receives the requests to the ensemble.
    """

    shared = True
    held = False
    may_begin = may_decide = True

    def __init__(self, control: ControlLayer, team: Team) -> None:
        self.catching_up = False
        self._control = control
        self._team = team
        self._taking = False  # a decision that ends a safe mode need not be published twice

    def open(self) -> None:
        """Refuse beliefs from outside: the agents share theirs."""
        self.catching_up = False
        control = self._control
        for name in ("external_belief", "initial_belief"):
            channel = control.owner.channel(name, Belief, retain=name == "initial_belief")
            control.subscribe(channel, self._refuse_belief)

    def _refuse_belief(self, belief: Belief) -> None:
        text = "refused a belief from outside: the team's agents share theirs"
        self._control.report("belief", text, time=belief.time)

    def asked(self, command: CommandName) -> bool:
        """Ask the team."""
        self._team.command(command)
        return True

    @property
    def period(self) -> float | None:
        """Seconds from one joint step of the team to the next; None where events make the steps."""
        return self._team.period

    @property
    def absence(self) -> str:
        """Who of the team is not there whose factors of the state are unknown, and what to do."""
        return self._team.absence

    # -- Safe modes ----------------------------------------------------------------------------------------------

    def hold(self, done: int | None) -> None:
        """Go on deciding: the team's knowledge must not depend on one agent's trouble."""

    def let_go(self) -> None:
        """Go on deciding, as `hold` does."""

    def latch(self) -> None:
        """Go on deciding, as `hold` does."""

    def go_on(self, time: int, *, restart: bool, predict: bool) -> None:
        """Publish the team's last decision, unless it is about to be published."""
        if not self._taking:
            self.repeat(time)

    def decide_again(self, time: int) -> bool:
        """Publish the team's last decision once more."""
        self.repeat(time)
        return True

    def observe_aside(self, observation: Observation) -> None:
        """Do nothing: only observations that are decided on are taken in."""

    def tick_aside(self, tick: Tick) -> None:
        """Do nothing: a team has ticks of its own."""

    def answer_later(self, cause: str, observation: Observed) -> None:
        """Do nothing: it was decided on."""

    # -- For the team ----------------------------------------------------------------------------------------------

    @property
    def running(self) -> bool:
        """Whether the layer decides."""
        return self._control.running

    def run(self, *, running: bool) -> None:
        """Let the layer decide, or no more, as the team has decided."""
        self._control.running = running

    @property
    def acted(self) -> int | None:
        """The last joint action that was published in this episode, or None."""
        return self._control.output.acted

    @property
    def blind(self) -> bool:
        """Whether the layer decides on states, and knows none."""
        return self._control.takes_states and self._control.state is None

    def another(self) -> Controller:
        """Return another controller of the same policy, model and options."""
        return self._control.another()

    def relay(self, tell: Callable[[Action], object]) -> None:
        """Pass each decision on to the team, too, until the layer starts again."""
        self._control.output.relay(tell)

    # -- Messages of the team ------------------------------------------------------------------------------------

    def take(self, message: Control | State | Observation) -> None:
        """Decide on a message now, in this call, as if it had come on its channel."""
        control = self._control
        if isinstance(message, Control):
            control.on_control(message)
            return
        alarms = control.alarms
        self._taking = True
        if isinstance(message, State):
            control.on_state(message)
        else:
            control.on_observation(message)
        guard = control.guard
        if guard is not None and guard.modes.causes and control.alarms == alarms and not control.blind:
            guard.reopen(AT_KNOWN, message.time)
        self._taking = False

    def carry_out(self, action: Action, belief: Vector | None = None) -> None:
        """Publish an action decided elsewhere, as if it had been decided here; on a belief, where one is known."""
        control = self._control
        self._taking = True
        control.running = True
        control.output.publish_foreign(action, belief)
        control.reopen(AT_KNOWN | {"lost_controller"}, action.time)
        self._taking = False

    def announce(self, step: Step, time: int, cause: str, observation: Observed = None) -> None:
        """Publish a decision that the team has had the layer's controller make, as if it answered an input here."""
        control = self._control
        alarms = control.alarms
        self._taking = True
        control.output.publish(step, time, cause, observation, None)
        if control.alarms == alarms:
            control.reopen(AT_KNOWN, time)
        self._taking = False

    def repeat(self, time: int) -> None:
        """Publish the present action once more, where there is one."""
        control = self._control
        if control.running:
            control.output.repeat(time, control.state)

    def catch_up(self, time: int, *, over: bool) -> None:
        """Repeat decisions made long ago without carrying them out; when that is over, carry out the present one.

        Args:
            time: When.
            over: Whether it is.
        """
        control = self._control
        self.catching_up = not over
        control.output.mute(muted=not over)
        if over and control.running and control.blind and control.guard is not None:
            control.guard.blind(time)
        elif over:
            if control.state is not None:  # known by a snapshot, too, in place of the steps that it stands for
                self._taking = True
                control.reopen(frozenset({"unknown_input"}), time)
                self._taking = False
            self.repeat(time)

    # -- Snapshots -----------------------------------------------------------------------------------------------

    def snapshot(self) -> bytes:
        """Return a snapshot, from which another agent can go on."""
        control = self._control
        held: Any = [control.controller.snapshot(), control.running, control.state, control.output.acted]
        return msgspec.msgpack.encode(held)

    def restore(self, snapshot: bytes) -> None:
        """Go on from a snapshot of a copy of the same configuration.

        Raises:
            ModelError: If it is invalid or of another configuration; the layer is unchanged.
        """
        control = self._control
        try:
            controller, running, state, acted = _opened(snapshot)
        except (msgspec.MsgspecError, TypeError, ValueError, RecursionError) as error:
            raise ModelError(f"this is not a snapshot of a control layer: {error}") from None
        for what, index, size in (
            ("state", state, control.controller.symbols.num_states),
            ("action", acted, control.controller.policy.num_actions),
        ):
            if index is not None and size is not None and not 0 <= index < size:
                raise ModelError(f"this is not a snapshot of a control layer: there is no {what} {index} of {size}")
        control.controller.restore(controller)
        control.running, control.state, control.output.acted = running, state, acted


Source = OwnChannels | JointProcess
"""Where a control layer's input comes from."""

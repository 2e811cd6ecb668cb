"""The planner: an actor that answers a control layer's questions by a tree search in a process of its own.

A question goes to the process, and the turn is over; the answer starts a turn of its own. The loop does nothing
meanwhile that takes longer than to send a belief. In virtual time, which must not go on while a process thinks, the
search runs within the turn, for its number of expansions and without regard to seconds: the same input gives the same
decisions.
"""

from __future__ import annotations

import asyncio
import os
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import anyio
import msgspec

from mdm.actors.layer import Layer
from mdm.actors.options import FixedRate
from mdm.compilation import COMPILE_TIME
from mdm.errors import ConfigError, Error
from mdm.messages import Answer, Control, Question
from mdm.runtime import ActorStatistics, Restart, VirtualClock
from mdm.runtime.channel import Subscription
from mdm.runtime.process.frames import HEADER, frame, unframed
from mdm.runtime.supervision import RestartBudget

if TYPE_CHECKING:
    from typing import Literal

    import numpy.typing as npt

    from mdm.actors.control.control_layer import ControlLayer
    from mdm.actors.control.output import Observed
    from mdm.actors.options import Drive
    from mdm.policies import Deliberating
    from mdm.policies.policy import Found
    from mdm.runtime import Timer

PATIENCE = 0.1
"""Seconds after its deadline for which the answer of a fallback is still in time."""

_SILENCE = 5.0
_LAST_WORDS = 0.5
_RESTART = Restart(limit=3, within=60.0, backoff=0.1)


class PlannerStatistics(ActorStatistics, frozen=True):
    """Counts of a planner: questions, and their answers.

    Attributes:
        asked: Questions.
        searched: Those that the search answered.
        fallbacks: Those that the fallback answered.
        superseded: Those that another one came after, before they were answered.
        late: Answers of the search that came after the deadline, or that no caller awaited any more; they are dropped.
        expansions: Leaves that were expanded for the answers, in all.
        processes: How often a process was started.
    """

    asked: int
    searched: int
    fallbacks: int
    superseded: int
    late: int
    expansions: int
    processes: int


class Planner(Layer):
    """Answers each `Question` on its ensemble's ``question`` with an `Answer` on ``answer``.

    The fallback answers at once while there is no process: until the first is ready (a second or so), and where one
    has died, which is reported; it is started again, at most three times a minute. And it answers where the search has
    not by the deadline; a later answer of the search is dropped and counted. A deadline counts from the first question
    that is open, even if others come after it. Without a fallback questions wait for the process, a missed deadline is
    answered with no action, and a process that cannot be kept alive is this actor's failure. Without a deadline a
    question that is open for 5 seconds, and twice the search's own, is reported.

    Args:
        policy: The search, with its fallback.
        drive: When it is asked; the time of a search is shorter than the period of a fixed rate.
        deadline: Seconds from a question's stimulus to its answer; by default, where there is a fallback and the search
            has a time, twice that time and a tenth of a second.
    """

    def __init__(
        self, policy: Deliberating, *, drive: Drive | None = None, deadline: float | None = None, name: str = "planner"
    ) -> None:
        super().__init__(name)
        if isinstance(drive, FixedRate) and (policy.seconds or 0.0) >= 1 / drive.rate:
            raise ConfigError(
                f"the search takes {policy.seconds} s, but a decision is due every {1 / drive.rate:g} s", key="policy"
            )
        self.policy = policy
        self._shielded = getattr(policy, "answered", None)
        if deadline is None and policy.fallback is not None and policy.seconds is not None:
            deadline = 2 * policy.seconds + PATIENCE
        self.deadline = deadline
        self._process: SearchProcess | None = None
        self._ready = anyio.Event()
        self._open: Question | None = None
        # When the stimulus of the newest question was told.
        self._told = 0
        self._timer: Timer | None = None
        self._silent = False
        self._virtual = False
        self._count = self._searched = self._fallbacks = self._superseded = self._late = 0
        self._expansions = self._processes = 0

    @property
    def pid(self) -> int | None:
        """The number of the process that searches, while there is one that is ready."""
        return None if self._process is None else self._process.pid

    async def ready(self) -> None:
        """Wait until there is a process that searches, or time is virtual."""
        while self._process is None and not self._virtual:
            await self._ready.wait()

    def on_start(self) -> None:
        """Listen, and start the process."""
        assert isinstance(self.parent, Layer)
        if self.runtime.dispatcher.choices.repeats:
            return  # its answers are in the record
        channel = self.parent.owner.channel
        self._process, self._open, self._timer = None, None, None
        self._silent = False
        self._virtual = isinstance(self.runtime.clock, VirtualClock)
        self._found = Subscription(None, self, self._on_found)
        self._answers = channel("answer", Answer)
        self._answers.input = True
        if self._shielded is not None and not hasattr(self.policy.fallback or self.policy, "wanted"):
            self.report("shield", "the fallback of the search is not shielded: what it decides may be dangerous")
        self.subscribe(channel("question", Question), self._on_question)
        self.subscribe(channel("control", Control), self._on_control)
        if not self._virtual:
            self.spawn(self._search(), name="search")
        elif self.policy.expansions is None:
            raise ConfigError(
                "in virtual time a tree search ends after a number of expansions, not of seconds: give it expansions",
                key="policy",
            )
        else:
            self.policy.prepare()

    # -- Questions and answers -----------------------------------------------------------------------------------

    def _on_question(self, question: Question) -> None:
        self._count += 1
        if self._open is not None:
            self._superseded += 1
        self._open = question
        self._told = question.time - self.runtime.dispatcher.waited(question.time)
        if self._virtual:
            result = self.policy.search(question.at, timed=False)
            self._expansions += result.expansions
            self._answer(result.action, "search", getattr(result, "wanted", None))
        elif self._process is not None:
            self._send(self._process, question)
        elif self.policy.fallback is not None:
            self._fall_back()
        if self._open is None or self._timer is not None:
            return
        if self.deadline is not None:
            self._timer = self.call_at(self._told + round(self.deadline * 1e9), self._on_deadline)
        elif not self._silent:
            self._timer = self.call_at(question.time + round(self._patience * 1e9), self._on_silence)

    def _send(self, process: SearchProcess, question: Question) -> None:
        process.ask(question.number, *self.policy.belief_of(question.at))

    def _on_found(self, found: tuple[int, Found]) -> None:
        number, result = found
        self._expansions += result.expansions
        if self._open is None or self._open.number != number:
            self._late += 1
        elif self.deadline is not None and self.runtime.clock.now() > self._told + round(self.deadline * 1e9):
            self._late += 1  # the loop has come late for it, ahead of the timer
            self._miss()
        else:
            assert self._open is not None
            its: Any = result if self._shielded is None else self._shielded(result, self._open.at)
            self._answer(its.action, "search", getattr(its, "wanted", None))

    def _on_deadline(self) -> None:
        self._timer = None
        if self._open is not None:
            self._miss()

    def _miss(self) -> None:
        """Let the fallback answer the open question at its deadline, or answer it with no action."""
        if self.policy.fallback is None:
            self._answer(None, "nothing")
            return
        self.report("deadline", f"the search has no answer after {self.deadline} s: the fallback decides")
        self._fall_back()

    @property
    def _patience(self) -> float:
        """Seconds after which a question without a deadline is reported."""
        return 2 * (self.policy.seconds or 0.0) + _SILENCE

    def _on_silence(self) -> None:
        self._timer = None
        if self._open is not None:
            self._silent = True
            state = "does not answer" if self._process is not None else "is not ready yet"
            self.report(
                "search",
                f"a question is open for {self._patience:g} s: the process that searches {state}, and there is no "
                f"deadline at which anything else decides",
            )

    def _fall_back(self) -> None:
        """Let the fallback answer the open question, if there is a fallback."""
        fallback: Any = self.policy.fallback
        if self._open is not None and fallback is not None:
            wanted = fallback.wanted(self._open.at) if hasattr(fallback, "wanted") else None
            self._answer(fallback.action(self._open.at), "fallback", wanted)

    def _answer(
        self, action: int | None, source: Literal["search", "fallback", "nothing"], wanted: int | None = None
    ) -> None:
        assert self._open is not None
        question = self._open
        self._silent = False
        self._forget()
        self._searched += source == "search"
        self._fallbacks += source == "fallback"
        self._answers.publish(Answer(question.time, question.number, action, source, wanted))

    def _on_control(self, control: Control) -> None:
        if control.command == "stop":
            self._forget()

    def _forget(self) -> None:
        self._open = None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    # -- The process ---------------------------------------------------------------------------------------------

    async def _search(self) -> None:
        """Keep a process at work, and hand on its answers."""
        budget = RestartBudget(_RESTART)
        while True:
            status = await self._serve()
            self.report("search", f"the process that searches has ended by itself, with status {status}")
            delay = budget.delay(self.runtime.clock.now())
            if delay is None:
                break
            await self.runtime.clock.sleep(delay)
        if self.policy.fallback is None:
            raise Error("the process that searches ends again and again, and there is no fallback to decide")
        self.report("search", "it is not started any more: the fallback decides from now on")

    async def _serve(self) -> int | None:
        """Start a process and hand on its answers until it dies; return its status."""
        process = SearchProcess(self.policy)
        try:
            self._processes += 1
            await process.start()
            self._process = process
            self._ready.set()
            self._ready = anyio.Event()
            if self._open is not None:
                self._send(process, self._open)
            while True:
                found = await process.answer()
                self.runtime.dispatcher.deliver(self._found, found)
        except (EOFError, OSError):
            pass
        finally:
            self._process = None
            status = await process.end()
        self.runtime.dispatcher.deliver(Subscription(None, self, lambda _: self._fall_back()), None)
        return status

    def statistics(self) -> PlannerStatistics:
        """Return the planner's counts so far."""
        return PlannerStatistics(
            **msgspec.structs.asdict(super().statistics()),
            asked=self._count,
            searched=self._searched,
            fallbacks=self._fallbacks,
            superseded=self._superseded,
            late=self._late,
            expansions=self._expansions,
            processes=self._processes,
        )


class Asking:
    """Asks a planner in place of a policy that answers at once; a control layer decides when the answer is there.

    Args:
        control: The layer.

    Attributes:
        stimulus: That of the question that is not answered yet: its time and cause, the observation and the state; None
            where there is none, or its answer is not wanted any more.
    """

    def __init__(self, control: ControlLayer) -> None:
        self.stimulus: tuple[int, str, Observed, int | None] | None = None
        self._control = control
        self._number = 0

    def open(self) -> None:
        """Listen to the planner."""
        self.stimulus = None
        channel = self._control.owner.channel
        self._now = self._control.runtime.clock.reader()
        self._questions = channel("question", Question)
        self._control.subscribe(channel("answer", Answer), self._on_answer)

    def ask(self, time: int, cause: str, observation: Observed, state: int | None) -> None:
        """Ask; a question that is still open is asked no more, and the answer decides for both."""
        control, controller = self._control, self._control.controller
        if state is not None:
            if controller.over:
                control.begin_episode()
            controller.advance(controller.symbols.state_index(state))
        self._number += 1
        control.output.waited = control.runtime.dispatcher.waited(time)
        self.stimulus = (time, cause, observation, state)
        at = controller.information.current if state is None else state
        self._questions.publish(Question(time, self._number, at))

    def ask_anew(self) -> None:
        """Ask once more, if a question is open: a tick's search begins again from another belief."""
        if self.stimulus is not None:
            time, cause, observation, _ = self.stimulus
            self._control.decide(time, cause, observation)

    def _on_answer(self, answer: Answer) -> None:
        control = self._control
        if self.stimulus is None or answer.number != self._number or not control.running:
            return
        (time, cause, observation, state), self.stimulus = self.stimulus, None
        if answer.action is None:
            control.late(self._now() - time + control.output.waited, time)
        else:
            step = control.controller.decide(answer.action)
            shield: Any = control.controller.policy
            if hasattr(shield, "note"):
                shield.note(step.at, answer.wanted)
            control.output.publish(step, time, cause, observation, state)


class SearchProcess:
    """Runs a policy's search in a process of its own; it imports nothing of the program, only the library.

    Args:
        policy: The search policy.
    """

    def __init__(self, policy: Deliberating) -> None:
        self._policy = policy
        self._process: asyncio.subprocess.Process | None = None
        self._waiting: tuple[int, npt.NDArray[Any], npt.NDArray[Any]] | None = None
        self._sending: asyncio.Task[None] | None = None

    @property
    def pid(self) -> int | None:
        """The process's number, once it has been started."""
        return None if self._process is None else self._process.pid

    async def start(self) -> None:
        """Start it, and wait until it is ready.

        Raises:
            EOFError: If it ended before.
            OSError: If it could not be started.
        """
        # A session of its own: Ctrl-C is for the program, which then ends it.
        program = f"from {self._policy.worker} import main; main(tells={COMPILE_TIME.is_told})"
        self._process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-P", "-c", program),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            start_new_session=True,
        )
        self._input.transport.set_write_buffer_limits(high=0)
        self._input.write(await asyncio.to_thread(frame, self._policy.parts()))
        await self._receive()

    def ask(self, number: int, states: npt.NDArray[Any], weights: npt.NDArray[Any]) -> None:
        """Send a question, in place of one that is not answered yet; returns at once.

        Where the process does not read, the newest question alone waits.
        """
        self._waiting = (number, states, weights)
        if self._sending is not None and not self._sending.done():
            return
        if self._input.transport.get_write_buffer_size():
            self._sending = asyncio.get_running_loop().create_task(self._send_when_read())
        else:
            self._send()

    def _send(self) -> None:
        question, self._waiting = self._waiting, None
        self._input.write(frame(question))

    async def _send_when_read(self) -> None:
        with suppress(ConnectionError):  # of which the caller that waits for the answer learns
            await self._input.drain()
            self._send()

    async def answer(self) -> tuple[int, Found]:
        """Wait for the next answer: the question's number and the result.

        Raises:
            EOFError: If the process has ended.
        """
        number, result = await self._receive()
        return number, result

    async def end(self) -> int | None:
        """End it, and return its status; None where there was none."""
        process = self._process
        if process is None:
            return None
        if self._sending is not None:
            self._sending.cancel()
        if process.stdin is not None:
            process.stdin.close()  # which ends it by itself, even if nobody waits here any more
        try:
            return await asyncio.wait_for(process.wait(), _LAST_WORDS)
        except TimeoutError:
            process.kill()
            return await process.wait()

    @property
    def _input(self) -> asyncio.StreamWriter:
        assert self._process is not None
        assert self._process.stdin is not None
        return self._process.stdin

    async def _receive(self) -> Any:
        assert self._process is not None
        assert self._process.stdout is not None
        read = self._process.stdout.readexactly
        try:
            length = int.from_bytes(await read(HEADER), "big")
            return unframed(await read(length))
        except (asyncio.IncompleteReadError, ConnectionError) as error:
            raise EOFError from error

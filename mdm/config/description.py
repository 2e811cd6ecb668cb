"""The system of a program's run, as a document like a TOML file's, and stand-ins for its code."""

from __future__ import annotations

import hashlib
import sys
import tempfile
import zlib
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.actors import Ensemble
from mdm.actors.options import BindingSettings, SafetySettings
from mdm.config.tables import SearchTable
from mdm.errors import Error, ModelError
from mdm.formats import save_model, save_policy
from mdm.loading import policy_of
from mdm.models import MDP
from mdm.policies import PACKABLE, BeliefPolicy, QTable, StatePolicy
from mdm.recording import Recorder, recorder
from mdm.runtime import Restart
from mdm.runtime.actor import descendants
from mdm.runtime.time.virtual import VirtualClock

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mdm.actors import Binding, ObservationFactor, StateFactor
    from mdm.actors.predicates.declarations import Declarations
    from mdm.runtime import Runtime
    from mdm.team import Member

FOLDER = "files/"
"""The beginning of the names of files that a record keeps for its configuration."""
CONFIGURATION = "system.json"
PACKED = ".zlib"
"""The end of the names of compressed files."""
LARGEST = 64 * 1024 * 1024
"""Bytes of a file that is kept, before it is compressed."""
_WAIT = 5.0


class Absent(msgspec.Struct, frozen=True):
    """A policy that is code: its class, its input, its form in words, its sizes, and that a record has no code."""

    name: str
    input: str
    form: str
    states: int
    actions: int
    why: str


class Description(msgspec.Struct, frozen=True):
    """The parts of a run.

    Attributes:
        system: The document, as `mdm.load_system` takes it.
        absent: Policies that are code, by the references that the document has to them.
        above: The paths of actors above ensembles and the predicate manager, see `mdm.config.System`.
        manager: The name of the predicate manager.
        cannot: The parts that the record does not hold, a sentence each.
        agent: Of a team, which agent the run was.
    """

    system: dict[str, Any]
    absent: dict[str, Absent] = {}
    above: dict[str, str | None] = {}
    manager: str = "predicates"
    cannot: tuple[str, ...] = ()
    agent: str | None = None


class Describer:
    """Keeps the parts of a run in its record, written by a thread: a large model takes a while."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._kept: set[str] = set()
        self._waiting: list[Future[tuple[Description, dict[str, bytes]]]] = []
        self._threads = ThreadPoolExecutor(1, thread_name_prefix="mdm-describe")

    def look(self, runtime: Runtime) -> None:
        """Describe the ensembles that there are by now."""
        actors, team = descendants(runtime.root), sys.modules.get("mdm.team.member")  # a robot alone has loaded none
        member = None if team is None else next((each for each in actors if isinstance(each, team.Member)), None)
        ensembles = [each for each in actors if isinstance(each, Ensemble)]
        if isinstance(runtime.clock, VirtualClock):
            self._write(*describe(ensembles, member))
            return
        future = self._threads.submit(describe, ensembles, member)
        self._waiting.append(future)
        if (loop := runtime.dispatcher.loop) is not None:
            future.add_done_callback(lambda done: loop.call_soon_threadsafe(self._keep, done))

    def finish(self) -> None:
        """Wait for descriptions that are being made, for some seconds at most; none is made from now on."""
        self._threads.shutdown(wait=False)
        for future in (*self._waiting,):
            self._keep(future)

    def _keep(self, future: Future[tuple[Description, dict[str, bytes]]]) -> None:
        if future not in self._waiting:
            return
        self._waiting.remove(future)
        try:
            found, files = future.result(_WAIT)
        except TimeoutError:
            found, files = Description({}, cannot=("model and policy took too long to write",)), {}
        self._write(found, files)

    def _write(self, found: Description, files: dict[str, bytes]) -> None:
        facts = {"cannot": msgspec.json.encode(found.cannot).decode()}
        facts |= {"configuration": CONFIGURATION} if found.system else {}
        facts |= {} if found.agent is None else {"agent": found.agent}
        new = {FOLDER + name: data for name, data in files.items() if name not in self._kept}
        self._kept |= files.keys()
        self._recorder.describe(new | {FOLDER + CONFIGURATION: msgspec.json.encode(found)}, facts)


_SUMMARY = "mdm.cli.records.page:within"
"""What makes the summary of a record, by name: it is loaded in the process that writes, as the record is closed."""


def recorder_of(given: object) -> Recorder:
    """Return the recorder that is given as itself or by the path of its file; it also keeps the parts of the run."""
    found = recorder.recorder_of(given)
    found.describer = Describer(found)
    found.summary = _SUMMARY
    return found


def describe(ensembles: Sequence[Ensemble], member: Member | None = None) -> tuple[Description, dict[str, bytes]]:
    """Return the description of a run's ensembles, and the files of their models and policies by name.

    Args:
        ensembles: All of the run.
        member: The agent of a team that the run is, if it is one.
    """
    making = _Making(member)
    manager = next((each.predicates for each in ensembles if each.predicates is not None), None)
    tables: dict[str, Any] = {}
    above: dict[str, str | None] = {}
    for ensemble in ensembles:
        name, path = ensemble.name, ensemble.path
        if name in tables or ensemble.predicates not in {None, manager}:
            what = "the name of" if name in tables else "another predicate manager than"
            making.cannot.append(f"ensemble {path!r} has {what} one that is described, and is not described itself")
            continue
        tables[name] = making.ensemble(ensemble)
        if not ensemble.bound and not making.is_joint(ensemble):
            above[name] = path.rpartition("/")[0]
    document: dict[str, Any] = {"ensembles": tables}
    if manager is not None:
        document |= _declared(manager.declared)
        if manager.declared.aged - manager.declared.max_age.keys():
            making.cannot.append("the map that predicates are told by is not in the record: a replay knows no places")
        place = manager.path.rpartition("/")[0]
        above[manager.name] = None if any(place == each.path for each in ensembles) else place
    if member is not None:
        document["team"] = making.team(member)
    kept = "predicates" if manager is None else manager.name
    cannot = tuple(dict.fromkeys(making.cannot))
    agent = None if member is None else member.agent
    return Description(document, making.absent, above, kept, cannot, agent), making.files


class _Making:
    """The tables of a description that is being made, its files, and sentences on its gaps."""

    def __init__(self, member: Member | None) -> None:
        self._member = member
        self.files: dict[str, bytes] = {}
        self.absent: dict[str, Absent] = {}
        self.cannot: list[str] = []

    def is_joint(self, ensemble: Ensemble) -> bool:
        """Whether a team decides in an ensemble."""
        return self._member is not None and ensemble.name in self._member.ensembles

    def ensemble(self, ensemble: Ensemble) -> dict[str, Any]:
        """Return the table of an ensemble."""
        settings, controller = ensemble.settings, ensemble.controller
        found = _changed(settings, SafetySettings, "rewards", "initial_belief", "tracker", "drive")
        given, model, agent = ensemble.made_of
        model = model if isinstance(model, MDP) else controller.model
        kept = None if model is None else self._file(ensemble, "model", model)
        found |= {} if kept is None else {"model": kept}
        found |= self._policy(ensemble, policy_of(given, model) if ensemble.local else controller.policy)
        if settings.rewards is not None:
            found["rewards"] = self._file(ensemble, "rewards", QTable(settings.rewards))
        if settings.initial_belief is not None:
            found["initial_belief"] = controller.symbols.belief_of(settings.initial_belief).tolist()
        if settings.tracker is not None:
            self.cannot.append(f"the tracker of ensemble {ensemble.path!r} is code, which a record does not hold")
        found |= {"local": ensemble.local, "drive": getattr(ensemble.status().drive, "rate", "event")}
        if self._member is not None and self.is_joint(ensemble):
            found["placement"] = msgspec.to_builtins(self._member.placements[ensemble.name])
        elif ensemble.local or ensemble.agent:
            found["agent"] = agent
        rule = ensemble.supervision
        limits = (
            {"restart": rule.limit, "within": rule.within, "backoff": rule.backoff}
            if isinstance(rule, Restart)
            else rule
        )
        found["supervision"] = limits
        if ensemble.state is not None:
            found["states"] = {each.name: _state(each) for each in ensemble.state.factors}
        if ensemble.observation is not None:
            found["observations"] = {each.name: _observation(each) for each in ensemble.observation.factors}
        bound = dict(zip(ensemble.action.names, ensemble.action.bindings, strict=True))
        found["actions"] = {name: _binding(each) for name, each in bound.items()}
        if (safe := ensemble.action.safe) is not None:
            own = {"call": _CALLED, "grace": safe.grace, "may_succeed": safe.may_succeed}
            found["safe_action"] = next((name for name, each in bound.items() if each is safe), own)
        return found

    def _policy(self, ensemble: Ensemble, policy: Any) -> dict[str, Any]:
        """Return the keys of a policy: its file, or the reference to its stand-in."""
        packable = getattr(policy, "kind", None) in PACKABLE
        if hasattr(policy, "wanted") and not packable:  # made again around its original
            found, model = self._policy(ensemble, policy.policy), ensemble.controller.model
            if found["policy"] in self.absent or model is None:
                return found
            states, actions = model.state_space.names, model.action_space.names
            margin = [(states[state], actions[action], states[after]) for state, action, after in policy.margin]
            options = {"avoid": policy.avoid, "keep": policy.keep, "margin": margin}
            return {**found, "shield": {name: value for name, value in options.items() if value}}
        if getattr(policy, "deliberates", False) and policy.fallback is not None:
            limits, seed, _, *rest = policy.parameters()
            search = {name: limit for name, limit in limits if limit and name in SearchTable.__struct_fields__}
            search["plans"] = len(rest) > len(policy.fallback.parameters())
            return {**self._policy(ensemble, policy.fallback), "search": search, "seed": seed}
        file = self._file(ensemble, "policy", policy) if packable else None
        if file is None:
            name, form = type(policy).__name__, str(getattr(policy, "form", "a policy"))
            reason = "is code, which a record does not hold" if not packable else "is not in the record"
            why = f"the policy of ensemble {ensemble.path!r}, {name}, {reason}"
            sizes = ensemble.controller.symbols.num_states or 0, policy.num_actions
            file = f"absent:a{len(self.absent)}"
            self.absent[file] = Absent(name, getattr(policy, "input", "belief"), form, *sizes, why)
            self.cannot.append(why)
        return {"policy": file}

    def _file(self, ensemble: Ensemble, what: str, value: Any) -> str | None:
        """Keep a model, a policy or rewards as a file that is named by its content; None where that is not possible."""
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder) / (what + (".policy" if what == "rewards" else ".npz"))
            try:
                (save_model if what == "model" else save_policy)(value, place)
                if (size := place.stat().st_size) > LARGEST:
                    raise Error(f"it takes {size:,} bytes, and a record keeps files of at most {LARGEST:,}")
            except Error as error:
                self.cannot.append(f"the {what} of ensemble {ensemble.path!r} is not in the record: {error}")
                return None
            data = place.read_bytes()
        name = f"{hashlib.sha256(data).hexdigest()[:16]}{place.suffix}"
        self.files.setdefault(name + PACKED, zlib.compress(data, 1))
        return name

    def team(self, member: Member) -> dict[str, Any]:
        """Return the table of a team."""
        team = member.team
        keys = ["name", "mode", "lease", "max_age", "router", *([] if team.mode == "centralised" else ["deadline"])]
        keys += {"replicated": ["quorum"], "centralised": ["controller"]}.get(team.mode, [])
        found = {key: getattr(team, key) for key in keys} | {"drive": getattr(team.drive, "rate", "event")}
        if team.mode == "communicating":
            self.cannot.append(f"the communication policy of team {team.name!r} is not in the record")
        return found | {"agents": [_changed(each, type(each)) for each in team.agents]}


_CALLED = "program:function"
"""In place of a function of the program, which nobody calls."""


def _changed(settings: msgspec.Struct, kind: type[msgspec.Struct], *without: str) -> dict[str, Any]:
    """Return the options of a struct that are others than by default."""
    fields = {each.name: each.default for each in msgspec.structs.fields(kind) if each.name not in without}
    return {name: getattr(settings, name) for name, default in fields.items() if getattr(settings, name) != default}


def _binding(binding: Binding) -> dict[str, Any]:
    """Return the table of an action."""
    settings: Any = binding.sequel
    found = _changed(settings, BindingSettings, "group") if isinstance(settings, BindingSettings) else {}
    if binding.ensemble is not None:
        return {**found, "ensemble": binding.ensemble.name}
    return {**found, "call": _CALLED, **({} if binding.group is None else {"group": str(id(binding.group))})}


def _declared(declared: Declarations) -> dict[str, Any]:
    """Return the tables of predicates and events."""
    tables: dict[str, Any] = {"predicates": {}, "events": {}}
    for name, kind in declared.names.items():
        found: dict[str, Any] = declared.written(name)
        found |= {"initial": declared.initial[name]} if name in declared.initial else {}
        tables[f"{kind}s"][name] = found
    for name in declared.used:  # a file declares teammates' predicates by the names of its own
        if "/" in name and (own := name.partition("/")[2]) not in declared.names:
            tables["predicates"][own] = {}
    return tables


def _state(factor: StateFactor) -> dict[str, Any]:
    """Return the table of a state factor."""
    symbols, names = factor.symbols, factor.predicates
    told: Any = names
    if symbols is not None:
        symbols = symbols if len(symbols) == len(names) else (symbols[factor.positive],)
        told = dict(zip(map(str, symbols), names, strict=True))
    return {"predicates": told, "on_violation": factor.on_violation, "owner": factor.owner}


def _observation(factor: ObservationFactor) -> dict[str, Any]:
    """Return the table of an observation factor."""
    symbols, events = factor.symbols, factor.events
    idle = None if factor.idle is None else str((symbols or events)[factor.idle])
    pairs = zip(map(str, symbols or ()), events, strict=False)
    told: Any = events if symbols is None else {symbol: event for symbol, event in pairs if event is not None}
    return {"events": told, "idle": idle, "hold": factor.hold, "owner": factor.owner}


def stand_in(absent: Absent) -> Any:
    """Return a policy of the same name and sizes as one that is code: it decides as the record says, where told."""
    sizes = {"num_states": absent.states, "num_actions": absent.actions, "form": absent.form, "absent": absent.why}
    return type(absent.name, (_Decided, StatePolicy if absent.input == "state" else BeliefPolicy), sizes)()


class _Decided:
    """A stand-in for a policy: its ``answers`` are the decisions to repeat, None where there are none."""

    absent: str
    answers: Iterator[int] | None = None

    def action(self, _: object) -> int:
        """Return the next decision."""
        if self.answers is None:
            raise ModelError(self.absent)
        return next(self.answers, 0)

    def scores(self, _: object) -> Any:
        """Weigh nothing: the policy's numbers are not known."""
        raise ModelError(self.absent)

"""``mdm import-ros1``: a package of the original, written as a TOML file with the files that it needs."""

from __future__ import annotations

import json
import re
import shutil
import warnings
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from mdm.cli.files import check
from mdm.cli.projects.examples import making
from mdm.cli.ros1.launch import Launch, Node, name_of, read_launch, roots
from mdm.cli.ros1.program import Action, Control, Declaration, Program, Text, programs, read_program
from mdm.errors import Error, ModelWarning
from mdm.formats import load_model

if TYPE_CHECKING:
    import argparse

    from mdm.models import MDP

_MODELS = {".mdp", ".pomdp", ".dpomdp", ".pomdpx", ".pgmx"}
_TAKEN = {"decision_period", "decision_horizon", "discount", "false_negative_obs", "mdm_agent_index"}
_FOR_NOTHING = {"is_sparse", "cache_flat_models", "marginalize", "pm_id", "pm_update_rate", "use_sim_time"}


def run(arguments: argparse.Namespace) -> int:
    """Import a package, and check the file that it became; return the exit status."""
    package = Path(arguments.package).resolve()
    if not package.is_dir():
        raise Error(f"{arguments.package}: there is no such folder; name that of a package")
    chosen = _launch(package, None if arguments.launch is None else Path(arguments.launch))
    imported = _Package(package, read_launch(chosen, package))
    target = Path(arguments.output or imported.name)
    with making(target) as made:
        (made / f"{imported.name}.toml").write_text(imported.text(made), encoding="utf-8")
    file = target / f"{imported.name}.toml"
    print(f"{file}: {imported.summary()}")
    given = {"imports": False, "live": False, "json": False, "model": None, "durations": None, "normalize": False}
    check.run(Namespace(file=str(file), **given))
    return 0 if imported.ensembles else 1


def _launch(package: Path, given: Path | None) -> Path:
    """Return the launch file to begin with: the only one from which a control layer is started."""
    if given is not None:
        for path in (given, package / given, package / "launch" / given):
            if path.is_file():
                return path.resolve()
        raise Error(f"{given}: there is no such launch file in {package}")
    makers = {name for name, paths in programs(package).items() if read_program(paths, package).controls}
    starting = [
        path
        for path in roots(package)
        if any(node.package == name_of(package) and node.type in makers for node in read_launch(path, package).nodes)
    ]
    if not starting:
        raise Error(
            f"{package}: no launch file starts a program of this package that makes a controller of the original "
            "(ControllerEventMDP, ControllerTimedMDP, ControllerEventPOMDP or ControllerTimedPOMDP)"
        )
    if len(starting) > 1:
        names = ", ".join(str(path.relative_to(package)) for path in starting)
        raise Error(f"{package}: several launch files make a control layer: {names}; name one with --launch")
    return starting[0]


class _Ensemble:
    """A control layer, with the layers that its topics join to it."""

    def __init__(self, name: str, node: Node, control: Control) -> None:
        self.name, self.node, self.control = name, node, control
        self.states: list[tuple[list[str], str]] = []
        self.observations: list[tuple[list[str], str]] = []
        self.actions: list[Action] = []
        self.acting: Node | None = None


class _Package:
    """The ensembles that a package makes, and their text."""

    def __init__(self, folder: Path, launch: Launch) -> None:
        self.folder, self.launch, self.name = folder, launch, name_of(folder)
        self.notes = launch.notes
        self._sources = programs(folder)
        self.nodes: list[tuple[Node, Program]] = []
        for node in launch.nodes:
            if node.package != self.name:
                continue
            if node.type not in self._sources:
                self.notes.leave(f"node {node.name!r}", node.place, f"there are no sources of {node.type!r}")
                continue
            program = read_program(self._sources[node.type], folder)
            self.nodes.append((node, program))
            self.notes.add(program.notes)
        found: dict[str, Declaration] = {}
        for _, program in self.nodes:
            for each in program.declarations:
                if each.name in found and each.place != found[each.name].place:
                    self.notes.leave(f"a second {each.name!r}", each.place)
                found.setdefault(each.name, each)
        self.declarations = found
        self.ensembles = self._ensembles()
        self._copied: dict[Path, str] = {}

    def summary(self) -> str:
        """Return the result in a line."""
        notes = len(self.notes.lines())
        return (
            f"{len(self.ensembles)} {'ensemble' if len(self.ensembles) == 1 else 'ensembles'}, "
            f"{len(self.declarations)} predicates and events; {notes} {'note' if notes == 1 else 'notes'} on what was "
            f"not taken over"
        )

    def _ensembles(self) -> list[_Ensemble]:
        found: list[_Ensemble] = []
        for node, program in self.nodes:
            for control in program.controls:
                name = self._name(node, {each.name for each in found})
                found.append(_Ensemble(name, node, control))
        for node, program in self.nodes:
            for ensemble in found:
                if node.topic("state") == ensemble.node.topic("state"):
                    ensemble.states += program.states
                if node.topic("observation") == ensemble.node.topic("observation"):
                    ensemble.observations += program.observations
                if program.actions and node.topic("action") == ensemble.node.topic("action"):
                    ensemble.actions += program.actions
                    ensemble.acting = node
        self._note_unjoined(found)
        return found

    def _note_unjoined(self, ensembles: list[_Ensemble]) -> None:
        """Note factors and actions of layers whose topics lead to no controller."""
        taken = [place for each in ensembles for _, place in (*each.states, *each.observations)]
        taken += [action.place for each in ensembles for action in each.actions]
        for _, program in self.nodes:
            rows = [("addStateFactor", ", ".join(names), place) for names, place in program.states]
            rows += [("addObservationFactor", ", ".join(names), place) for names, place in program.observations]
            rows += [("addAction", action.name, action.place) for action in program.actions]
            for call, what, place in rows:
                if place not in taken:
                    self.notes.leave(f"{call} ({what})", place, "no controller is joined to its layer")

    def _name(self, node: Node, taken: set[str]) -> str:
        last = node.namespace.rpartition("/")[2]
        own = re.sub(r"_?(control(ler)?|mdp|pomdp)(_layer)?$", "", node.name)
        name = next(
            (word for word in (last, own, self.name) if re.fullmatch(r"[A-Za-z]\w*", word) and word not in taken),
            node.name,
        )
        while name in taken:
            name += "_"
        return name

    # -- The text ------------------------------------------------------------------------------------------------

    def text(self, made: Path) -> str:
        """Return the TOML file, and copy the files that it needs to a folder."""
        ensembles = [line for ensemble in self.ensembles for line in ("", *self._ensemble(ensemble, made))]
        lines = [f"# Imported from the package {self.name} of the original MDM for ROS."]
        lines += [f"# not taken over: {self._told(note)}" for note in self.notes.lines()]
        lines += ["", 'tasks = ["robot:live"]  # tells what is sensed, and poses where there is a map', ""]
        lines += self._places(made)
        declared = [
            each
            for each in self.declarations.values()
            if each.event or each.kind != "place" or each.name not in self._place_names
        ]
        used = {name for ensemble in self.ensembles for names, _ in ensemble.states for name in names}
        seen = {name for ensemble in self.ensembles for names, _ in ensemble.observations for name in names}
        known = set(self.declarations) | set(self._place_names)
        lines += ["[predicates]", *(self._declared(each) for each in declared if not each.event)]
        lines += [f"{_key(name)} = {{}}  # told by another program" for name in sorted(used - known)]
        lines += ["", "[events]", *(self._declared(each) for each in declared if each.event)]
        lines += [f"{_key(name)} = {{}}  # raised by another program" for name in sorted(seen - known)]
        return "\n".join([*lines, *ensembles]) + "\n"

    def _told(self, text: str) -> str:
        return text.replace(f"{self.folder}/", "").replace("\n", " ")

    def _was(self, what: str, place: str) -> str:
        return f"# was: {self._told(what)}, of {self._told(place)}"

    def _declared(self, each: Declaration) -> str:
        """Return the line of a predicate or an event."""
        given, about = "{}", each.about or ("" if each.event else "a label of the map, which has no such place")
        if each.kind == "formula":
            given, about = json.dumps(each.formula), "a formula"
        elif each.kind == "latch" and not each.event:
            setter, reset = map(json.dumps, each.turns)
            given = f"{{ set = {setter}, reset = {reset}, initial = false }}"
        return f"{_key(each.name)} = {given}  {self._was(about, each.place)}"

    # -- The map -------------------------------------------------------------------------------------------------

    def _places(self, made: Path) -> list[str]:
        """Return the table of places; empty without a topological map."""
        self._place_names: tuple[str, ...] = ()
        for node, program in self.nodes:
            if program.map is None:
                continue
            graph = self._file(node, program.map, f"the topological map of {node.name!r}")
            from mdm.maps import load_graph  # noqa: PLC0415 - most packages have no map

            self._place_names = load_graph(graph).names
            lines = [self._was("a topological map", node.place), "[places]", f"graph = {self._copy(graph, made)}"]
            images = [each for each in self.launch.nodes if "pose_labeler" in each.type and each.arguments]
            if not images:
                lines.append("reach = 1.0  # metres around each goal, for there is no image of labels")
            else:
                labels = self._copy(self._file(images[0], (1,), "the image of labels"), made)
                lines += [f"labels = {labels}", f"grid = {json.dumps(self._grid(made))}"]
                lines += [f"names = {self._copy(names, made)}" for names in self._label_names()]
            return [*lines, 'navigator = "robot:Navigator"  # what drives to a goal', ""]
        return []

    def _label_names(self) -> list[Path]:
        """Return the file of the names of labels, where one is loaded."""
        for namespace, path in self.launch.files:
            if namespace.rpartition("/")[2] == "predicate_labels" or path.name == "predicate_labels.yaml":
                if not path.is_file():
                    raise Error(f"there is no file {path}, which a <rosparam> loads")
                return [path]
        return []

    def _grid(self, made: Path) -> str:
        """Copy the map with its image, and return its name."""
        servers = [node for node in self.launch.nodes if node.type == "map_server" and node.arguments]
        servers.sort(key=lambda node: "/map" in node.remappings or "map" in node.remappings)
        if not servers:
            raise Error(f"{self.folder}: an image of labels needs a map: no launch file starts a map_server with one")
        path = self._file(servers[0], (1,), "the map")
        text = path.read_text(encoding="utf-8")
        image = re.search(r"^(image\s*:\s*)(\S+)", text, re.MULTILINE)
        if image is None:
            raise Error(f"{path}: a map names its image, in a line image: FILE")
        picture = path.parent / image[2].strip("\"'")
        if not picture.is_file():
            raise Error(f"{path}: there is no image {picture}")
        name = json.loads(self._copy(picture, made))
        (made / path.name).write_text(text.replace(image[0], f"{image[1]}{name}"), encoding="utf-8")
        return path.name

    # -- Files ---------------------------------------------------------------------------------------------------

    def _file(self, node: Node, given: Text | None, what: str) -> Path:
        """Return a file that a program is given: by its name, or by words of its command line."""
        if given is None:
            raise Error(f"{node.place}: {what} is not a literal name in the program {node.type!r}")
        words = node.arguments or []
        missing = [part for part in given if isinstance(part, int) and part > len(words)]
        if missing:
            raise Error(f"{node.place}: {node.name!r} has no argument {missing[0]}, which is {what}")
        name = "".join(words[part - 1] if isinstance(part, int) else part for part in given)
        path = Path(name) if Path(name).is_absolute() else self.folder / name
        if not path.is_file():
            raise Error(f"{node.place}: there is no file {path}, {what}")
        return path

    def _copy(self, path: Path, made: Path) -> str:
        """Copy a file to the folder, and return its name as TOML has it."""
        if path not in self._copied:
            name = path.name
            while name in self._copied.values():
                name = f"{path.parent.name}_{name}"
            shutil.copyfile(path, made / name)
            self._copied[path] = name
        return json.dumps(self._copied[path])

    # -- Ensembles -----------------------------------------------------------------------------------------------

    def _ensemble(self, ensemble: _Ensemble, made: Path) -> list[str]:
        node, control = ensemble.node, ensemble.control
        lines = [
            self._was(f"{control.kind} of node {node.name!r}", control.place),
            f"[ensembles.{_key(ensemble.name)}]",
        ]
        files = self._files(node, control)
        model = next((path for path in files if path.suffix in _MODELS), None)
        policies = [path for path in files if path is not model]
        if not policies and control.is_known:
            raise Error(
                f"{node.place}: {control.kind} names no policy; the file of a value function or policy was expected"
            )
        if "POMDP" in control.kind and model is None and control.is_known:
            raise Error(f"{node.place}: {control.kind} needs a problem file, with one of {', '.join(sorted(_MODELS))}")
        if model is not None:
            lines.append(f"model = {self._copy(model, made)}")
        lines += [f"policy = {self._copy(path, made)}" for path in policies[:1]]
        if not control.is_known:  # such as the Q-table that a learner keeps
            more = f"  # was: another file of {control.kind}"
            lines += [f"# policy = {self._copy(path, made)}{more}" for path in policies[1:]]
        lines += self._options(ensemble)
        loaded = None if model is None else _loaded(model)
        lines += self._factors("states", ensemble, loaded)
        lines += self._factors("observations", ensemble, loaded)
        return [*lines, *self._bindings(ensemble, loaded)]

    def _files(self, node: Node, control: Control) -> list[Path]:
        """Return the files that a controller is given; of one that is not known, those that are there."""
        files = []
        for given in control.arguments:
            if given is not None:
                try:
                    files.append(self._file(node, given, f"a file of {control.kind}"))
                except Error as error:
                    if control.is_known:
                        raise
                    self.notes.leave(f"a file of {control.kind}", node.place, str(error))
        return files

    def _parameters(self, ensemble: _Ensemble) -> dict[str, str]:
        """Return the parameters that its layers find: of their namespaces, from the outermost, and their own."""
        given: dict[str, str] = {}
        for node in (ensemble.node, ensemble.acting):
            if node is None:
                continue
            for match in re.finditer("/", f"{node.namespace}/"):
                prefix = f"{node.namespace[: match.start()]}/"
                given |= {
                    name.removeprefix(prefix): value
                    for name, value in self.launch.parameters.items()
                    if name.startswith(prefix) and "/" not in name.removeprefix(prefix)
                }
            given |= node.parameters
        return given

    def _options(self, ensemble: _Ensemble) -> list[str]:
        given, place = self._parameters(ensemble), ensemble.node.place
        lines = []
        known = ensemble.control.is_known
        if "Timed" in ensemble.control.kind or (not known and "decision_period" in given):
            period = _number(given.get("decision_period"))
            if not period or period < 0:
                raise Error(f"{place}: {ensemble.control.kind} needs a parameter decision_period, in seconds")
            lines.append(f"drive = {1 / period!r}  # decisions a second")
        for name, key in (("decision_horizon", "horizon"), ("discount", "discount"), ("mdm_agent_index", "agent")):
            value = _number(given.get(name))
            if value is not None:
                lines.append(f"{key} = {int(value) if key != 'discount' else value!r}  {self._was(name, place)}")
        if "false_negative_obs" in given:
            value = _number(given["false_negative_obs"])
            shown = json.dumps(given["false_negative_obs"]) if value is None else str(int(value))
            lines.append(f"false_negative = {shown}  {self._was('false_negative_obs', place)}")
        for name, text in given.items():
            if name not in _TAKEN:
                reason = "it has no meaning here" if name in _FOR_NOTHING else "it is not known"
                lines.append(f"# was: parameter {name} = {text}, of {self._told(place)}: {reason}")
        return lines

    def _factors(self, kind: str, ensemble: _Ensemble, model: MDP | None) -> list[str]:
        found = ensemble.states if kind == "states" else ensemble.observations
        if not found:
            return []
        space = None if model is None else model.state_space if kind == "states" else model.observation_space
        names = [f"{'state' if kind == 'states' else 'observation'}{place}" for place in range(len(found))]
        if space is not None and len(space.factors) == len(found):
            names = [factor.name or name for factor, name in zip(space.factors, names, strict=True)]
        lines = ["", f"[ensembles.{_key(ensemble.name)}.{kind}]"]
        for name, (symbols, place) in zip(names, found, strict=True):
            call = "addStateFactor" if kind == "states" else "addObservationFactor"
            lines.append(f"{_key(name)} = {json.dumps(symbols)}  {self._was(call, place)}")
        return lines

    def _bindings(self, ensemble: _Ensemble, model: MDP | None) -> list[str]:
        lines = ["", f"[ensembles.{_key(ensemble.name)}.actions]"]
        names: list[str] = [action.name for action in ensemble.actions]
        if model is not None:
            factors = model.action_space.factors
            own = next((factor.names for factor in factors if len(factor.names) == len(names)), ())
            if own and not set(names) <= set(own):
                names = list(own)
        if len(set(names)) < len(names):
            names = [f"{name}{place}" for place, name in enumerate(names)]
        for name, action in zip(names, ensemble.actions, strict=True):
            child = self._child(ensemble, action)
            if action.way:
                target = f"{{ way = {json.dumps(action.name)} }}"
            elif child is not None:
                target = f"{{ ensemble = {json.dumps(child)} }}"
            else:
                routine = action.routine
                target = json.dumps(f"robot:{action.name if routine is None else routine.name}")
            place = action.place if action.routine is None or child is not None else action.routine.place
            lines.append(f"{_key(name)} = {target}  {self._was('addAction', place)}")
        return lines

    def _child(self, ensemble: _Ensemble, action: Action) -> str | None:
        """Return the ensemble that an action starts by a service."""
        if action.routine is None or ensemble.acting is None:
            return None
        for service in action.routine.services:
            full = ensemble.acting.topic(service)
            for other in self.ensembles:
                if other is not ensemble and full in {other.node.topic("start"), other.node.topic("reset")}:
                    return other.name
        return None


def _loaded(path: Path) -> MDP:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)  # the check that follows tells them
        return load_model(path)


def _number(text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return None


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name)

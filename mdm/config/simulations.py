"""A recorded simulation: which model and policy it was of, as its record's head says, and the ensemble that it ran."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.config.builder import load_system, load_team
from mdm.config.recorded import lay_out
from mdm.errors import Error
from mdm.formats import load_model
from mdm.loading import pair_of
from mdm.simulation.simulate import simulated

if TYPE_CHECKING:
    from mdm.actors import Ensemble
    from mdm.recording import Record

__all__ = ["Simulated", "recorded_simulation"]


class Simulated(msgspec.Struct, frozen=True):
    """What a simulation is of: an ensemble of a TOML file, or a model and a policy by their files.

    Attributes:
        file: The TOML file; None where it is of a model and a policy.
        ensemble: Which of the file's ensembles; by default the first.
        model: The model's file.
        policy: The policy's file.
        discount: In place of the model's own.
        false_negative: The observation that is seen where nothing is.
        steps: Decisions in an episode.
        seed: Of all chances.
    """

    file: str | None = None
    ensemble: str | None = None
    model: str | None = None
    policy: str | None = None
    discount: float | None = None
    false_negative: str | None = None
    steps: int | None = None
    seed: int | None = None

    def options(self) -> dict[str, Any]:
        """Return the arguments of `mdm.simulation.simulate`, but for the number of episodes and the seed.

        Raises:
            ConfigError: If the file has problems.
            Error: If it has no such ensemble, or none that can be simulated.
            FormatError: If the model's or the policy's file is malformed.
        """
        return self._of_file(self.file) if self.file is not None else self._of_model()

    def _of_model(self) -> dict[str, Any]:
        assert self.model is not None
        assert self.policy is not None
        model = load_model(self.model)
        if self.discount is not None:
            model = model.with_discount(self.discount)
        policy, seen = pair_of(model, self.policy, seed=self.seed, false_negative=self.false_negative)
        return {"model": seen, "policy": policy, "steps": self.steps}

    def _of_file(self, file: str) -> dict[str, Any]:
        if (team := load_team(file)) is not None:
            raise Error(
                f"{file}: this file describes the team {team.name!r}, of which no agent can be simulated alone: give "
                f"the team's --model and --policy"
            )
        system = load_system(file, callbacks=False)
        name = self.ensemble or system.top[0].name
        if name not in system.ensembles:
            raise Error(f"{file}: there is no ensemble {name!r}; there are {', '.join(system.ensembles)}")
        status, controller = system.ensembles[name].status(), system.ensembles[name].controller
        if controller.model is None:
            raise Error(f"{file}: ensemble {name!r} has no model to simulate")
        if controller.policy.num_actions != len(controller.model.action_space):
            raise Error(
                f"{file}: ensemble {name!r} runs one agent's part of a policy: give the team's --model and --policy"
            )
        return {
            "model": controller.model,
            "policy": controller.policy,
            "steps": self.steps or controller.horizon,
            "drive": status.drive,
            "on_impossible": "predict" if controller.on_impossible == "safe_action" else controller.on_impossible,
            "on_no_observation": status.on_no_observation,
            "tracker": controller.information if controller.has_own_tracker else None,
        }


def recorded_simulation(record: Record, folder: str | Path, given: str | Path | None = None) -> Ensemble:
    """Return the ensemble of a recorded simulation.

    Args:
        record: The record, whose head says what was simulated.
        folder: Where files of the record are laid out.
        given: A TOML file, in place of what was simulated.

    Raises:
        Error: If the head says nothing that can be simulated, or as `Simulated.options`.
    """
    try:
        told = msgspec.json.decode(record.head["simulation"], type=Simulated)
    except msgspec.MsgspecError as error:
        raise Error(f"{record.path}: its head does not say what was simulated: {error}") from None
    if given is not None:
        told = msgspec.structs.replace(told, file=str(given), ensemble=told.ensemble if told.file else None)
        return simulated(**told.options(), seed=told.seed)
    if told.file is None and (told.model is None or told.policy is None):
        raise Error(f"{record.path}: its head does not say what was simulated: neither a file nor model and policy")
    here = lay_out(record, folder)
    names = {name: getattr(told, name) for name in ("file", "model", "policy")}
    for file in names.values():
        if file is not None and Path(file).name != file:
            raise Error(f"{record.path}: its head says that {file!r} was simulated, which is no name of a file")
    placed = {name: str(here / file) for name, file in names.items() if file is not None}
    return simulated(**msgspec.structs.replace(told, **placed).options(), seed=told.seed)

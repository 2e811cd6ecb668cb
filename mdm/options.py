"""Options, each declared once: a field of a struct with its type, bounds, unit and default.

Keyword arguments make the struct, and a table of a TOML file is the struct or derives from it, so that one place checks
both. For type checkers the keywords have a typed dictionary beside the struct; a test holds the two equal.
"""

from __future__ import annotations

import difflib
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypedDict, get_args, get_type_hints

import msgspec
from msgspec import Meta

from mdm.checks import is_number, is_whole
from mdm.errors import ConfigError
from mdm.texts import in_words

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Self

    import numpy.typing as npt

    from mdm.beliefs import Information
    from mdm.models.space import Symbol

__all__ = ["ControllerOptions", "ControllerSettings", "Megabytes", "OnImpossible", "Options", "Seconds", "misfit"]

Seconds = Annotated[float, Meta(gt=0, le=1e9, extra={"unit": "seconds"})]
Megabytes = Annotated[float, Meta(gt=0, extra={"unit": "megabytes"})]
OnImpossible = Literal["predict", "keep", "reset", "safe_action"]


class Options(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Options or a TOML table: values that do not fit their fields are refused, and unknown names are.

    Numbers of numpy become Python's. A field of the type `Any` is for objects that no file holds; who takes it checks
    it.

    Raises:
        ConfigError: If a value does not fit; with its field as the key.
    """

    def __post_init__(self) -> None:
        for name, kind, default in _checked(type(self)):
            value = getattr(self, name)
            if value is default:
                continue
            if type(value) not in {float, int, str, bool} and is_number(value):
                value = int(value) if is_whole(value) else float(value)
            try:
                msgspec.structs.force_setattr(self, name, msgspec.convert(value, kind))
            except msgspec.ValidationError as error:
                text, place = misfit(error, value, kind)
                raise ConfigError(text, key=f"{name}{place}") from None
            except (AttributeError, TypeError, ValueError) as error:  # of an object that msgspec does not know
                raise ConfigError(f"{value!r} cannot be a value of it", key=name) from error

    @classmethod
    def from_keywords(cls, given: Mapping[str, Any], *, below: str = "") -> Self:
        """Return the options that keyword arguments give.

        Args:
            given: The arguments.
            below: What the keys of errors begin with, such as ``team.``.

        Raises:
            ConfigError: If there is no such option (the message suggests similar names), or a value does not fit.
        """
        names = cls.__struct_fields__
        for option in given:
            if option not in names:
                close = difflib.get_close_matches(option, names, n=3)
                hint = f"did you mean {' or '.join(map(repr, close))}?" if close else f"there are {', '.join(names)}"
                raise ConfigError(f"there is no option {option!r}; {hint}", key=below + option)
        try:
            return cls(**given)
        except ConfigError as error:
            raise ConfigError(error.message, key=f"{below}{error.key}") from None

    def as_arguments(self, kind: type[Options]) -> Any:
        """Return the values of the fields that another struct of options declares, as keyword arguments."""
        return {name: getattr(self, name) for name in kind.__struct_fields__}


@cache
def _checked(options: type[Options]) -> list[tuple[str, Any, Any]]:
    """Return the name, type and default of each field that msgspec checks."""
    hints = get_type_hints(options, include_extras=True)
    fields = [(field.name, hints[field.name], field.default) for field in msgspec.structs.fields(options)]
    return [each for each in fields if each[1] is not Any]


def misfit(error: msgspec.ValidationError, value: Any, kind: Any) -> tuple[str, str]:
    """Return in words, with its unit, how a value does not fit a type; and the place in the value.

    Args:
        error: What msgspec said.
        value: The value.
        kind: The type: of a field, or a struct of a table.
    """
    text, _, place = str(error).partition(" - at `$")
    place = place.rstrip("`").replace("[...]", "")
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        field = place.removeprefix(".").partition("[")[0]
        kind = get_type_hints(kind, include_extras=True).get(field, kind)
    bounds = next((each for each in _parts(kind) if isinstance(each, Meta)), None)
    choices = [each for each in _parts(kind) if isinstance(each, str)]
    return in_words(text, value, place, bounds, choices), place


def _parts(kind: Any) -> list[Any]:
    """Return the arguments of a type, and theirs: choices, bounds."""
    return [each for argument in get_args(kind) for each in (argument, *_parts(argument))]


class ControllerSettings(Options, frozen=True, kw_only=True):
    """The options of a controller, and so of control layers, ensembles and simulations.

    Attributes:
        horizon: Decisions per episode, at most (and by default) the number of the policy's stages. The next input then
            begins a new episode.
        on_impossible: The treatment of an observation of probability 0: ``predict`` (the default) updates without an
            observation, ``keep`` keeps the information state, ``reset`` resets it, and ``safe_action`` predicts, while
            a control layer also runs the safe action.
        rewards: R(s, a), an S x A array; by default the model's.
        initial_belief: The initial belief: S numbers, or the name or index of a certain state; by default the model's.
        tracker: An information state of your own; see `mdm.beliefs.Information`.
        false_negative: The observation, by name or index, of an undetected event; see `POMDP.with_false_negatives`.
        memory: The most megabytes that the model may take here, as matrices or as its beliefs need them; one that would
            take more is refused before they are made. Memory then counts for more than microseconds: a factored model
            stays factored (`MDP.sparingly`). By default all that the machine has free, and speed counts.
        seed: The seed of a stochastic policy: equal seeds give equal decisions.
    """

    horizon: Annotated[int, Meta(ge=1, extra={"unit": "decisions"})] | None = None
    on_impossible: OnImpossible = "predict"
    rewards: Any = None
    initial_belief: Any = None
    tracker: Any = None
    false_negative: Any = None
    memory: Megabytes | None = None
    seed: Annotated[int, Meta(ge=0)] | None = None


class ControllerOptions(TypedDict, total=False):
    """The keyword arguments of `ControllerSettings`."""

    horizon: int | None
    on_impossible: OnImpossible
    rewards: npt.ArrayLike | None
    initial_belief: Any
    tracker: Information | None
    false_negative: Symbol | None
    memory: float | None
    seed: int | None


ControllerOptions.__doc__ = ControllerSettings.__doc__

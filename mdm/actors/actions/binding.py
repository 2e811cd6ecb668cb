"""Bindings: which code an action symbol stands for."""

from __future__ import annotations

import dis
import inspect
from collections.abc import Awaitable, Callable, Mapping
from copy import copy
from functools import cache
from types import CodeType, FunctionType, MethodType
from typing import TYPE_CHECKING, Any, Unpack

from mdm.actors.options import BindingOptions, BindingSettings
from mdm.errors import ConfigError, Error
from mdm.logic import similar
from mdm.runtime.handler import kind_of

if TYPE_CHECKING:
    from mdm.actors.ensemble import Ensemble
    from mdm.actors.options import Sequel
    from mdm.messages import Action

Callback = Callable[..., Awaitable[object] | object]


class AbandonedError(Error):
    """Raised by an action that ends while its device may go on: it counts as abandoned."""


class Binding:
    """An action's target, and how its lives are led.

    Args:
        target: A plain function (called at once), an ``async`` function (run as a task), or an `Ensemble` (started
            and stopped). A function that takes an argument gets the `Action` message.
        goes_on: With ``restart``, a plain function that is called when the same action is chosen again: whether the
            task goes on all the same, since it would do the same. A function that takes an argument gets the
            `Action` message.
        options: See `BindingOptions`.

    Attributes:
        plain: Whether it is a plain function.
        brief: Whether it is one that begins and ends alone, by a call.
        note: A note that `mdm check` prints behind its name; empty for none.
        lasts: Whether it takes time, as far as can be told before it is called.
        sequel: What follows its end.
        retries: Whether a failure is followed by a decision, as of drives to a goal where ``then`` says nothing.
    """

    __slots__ = (
        "_asks_action",
        "brief",
        "concurrent",
        "ensemble",
        "function",
        "goes_on",
        "grace",
        "group",
        "lasts",
        "may_succeed",
        "note",
        "on_repeat",
        "plain",
        "resume",
        "retries",
        "sequel",
        "takes_action",
        "target",
        "timeout",
    )

    def __init__(
        self,
        target: Callback | Ensemble,
        *,
        goes_on: Callable[..., bool] | None = None,
        **options: Unpack[BindingOptions],
    ) -> None:
        settings = BindingSettings.from_keywords(options)
        if goes_on is not None and settings.on_repeat != "restart":
            raise ConfigError("goes_on is for an action that starts again: give on_repeat='restart'", key="goes_on")
        if settings.group is not None and settings.concurrent:
            raise ConfigError("a concurrent action replaces no other: leave its group out", key="group")
        self.target = target
        self.timeout = settings.timeout
        self.grace = settings.grace
        self.on_repeat = settings.on_repeat
        self.resume = settings.resume
        self.concurrent = settings.concurrent
        self.goes_on = goes_on
        self._asks_action = goes_on is not None and _takes_action(goes_on)
        self.group = settings.group
        self.may_succeed = settings.may_succeed
        self.note = ""
        self.sequel: Sequel = settings
        self.retries = settings.then == "decide"
        self.ensemble: Ensemble | None = None
        self.function: Callable[..., Any] = _no_call
        self.takes_action = False
        if callable(target):
            kind = kind_of(target)
            if kind not in {None, "an async function"}:
                name = getattr(target, "__qualname__", repr(target))
                raise ConfigError(
                    f"an action's target is a function that is called or awaited, but {name} is {kind}, and a call "
                    f"would run none of it"
                )
            self.function = target
            self.takes_action = _takes_action(target)
        elif hasattr(target, "when_idle"):
            self.ensemble = target
        else:
            raise ConfigError(f"an action's target is a function or an ensemble, not {target!r}")
        self.plain = self.ensemble is None and kind_of(self.function) is None
        self.lasts = not self.plain
        self.brief = self.plain and not self.concurrent and not self.sequel.counts

    def continues(self, action: Action) -> bool:
        """Whether a running task goes on when the action is chosen again, by that message."""
        if self.on_repeat == "continue":
            return True
        if self.goes_on is None:
            return False
        return self.goes_on(action) if self._asks_action else self.goes_on()

    def standing_in(self, function: Callable[..., object], *, asks: bool = False) -> Binding:
        """Return a binding alike, with another function in place of its own; that of an ensemble is itself.

        Where it ``asks``, the function takes the action as its own does.
        """
        if self.ensemble is not None:
            return self
        binding = copy(self)
        binding.function, binding.takes_action = function, asks and self.takes_action
        return binding

    def within(self, ensemble: Ensemble) -> Binding:
        """Return the binding to use as an action of an ensemble; by default itself.

        A binding with a function that depends on its ensemble's model returns a new binding for each ensemble.
        """
        return self


def bind(target: Callback | Ensemble, **options: Any) -> Binding:
    """Bind an action to a target with options; see `Binding`."""
    return Binding(target, **options)


@cache
def _returns_nothing(code: CodeType) -> bool:
    steps = [*dis.get_instructions(code)]
    before = ((step.opname == "LOAD_CONST" and step.argval is None) for step in steps)
    for nothing, step in zip(before, steps[1:], strict=False):
        if step.opname == "RETURN_VALUE" and (step.is_jump_target or not nothing):
            return False
    return not any(step.opname == "RETURN_CONST" and step.argval is not None for step in steps)  # of later versions


def returns_nothing(function: Callable[..., object]) -> bool:
    """Whether it is plain from the code of a plain function that it returns None, if it returns."""
    held: Any = function if isinstance(function, FunctionType | MethodType) else type(function).__call__
    return hasattr(held, "__code__") and _returns_nothing(held.__code__)


def _no_call() -> None:
    return None


def _takes_action(function: Callback) -> bool:
    """Whether a function is to be called with the action message."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):  # a builtin without a signature takes nothing
        return False
    required = [
        parameter
        for parameter in parameters
        if parameter.kind in {parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD}
        and parameter.default is parameter.empty
    ]
    keyword = [p.name for p in parameters if p.kind is p.KEYWORD_ONLY and p.default is p.empty]
    if len(required) > 1 or keyword:
        names = ", ".join([*(parameter.name for parameter in required), *keyword])
        name = getattr(function, "__qualname__", repr(function))
        raise ConfigError(f"an action's function takes no argument or the Action message, but {name} asks for {names}")
    return bool(required) or any(parameter.kind is parameter.VAR_POSITIONAL for parameter in parameters)


def bindings_of(
    names: tuple[str, ...],
    bindings: Mapping[str, Callback | Ensemble | Binding] | Mapping[int, Callback | Ensemble | Binding],
) -> tuple[Binding, ...]:
    """Return the binding of each action, in the order of the model.

    Args:
        names: The model's actions.
        bindings: The target of each, by name or by index.

    Raises:
        ConfigError: If an action has none, a key is no action, or a target is neither function nor ensemble.
    """
    if not isinstance(bindings, Mapping):
        raise ConfigError(
            f"actions are a mapping from every action's name or index to a function or an ensemble, not {bindings!r}",
            key="actions",
        )
    keys = list(bindings)
    if not (all(isinstance(key, str) for key in keys) or all(type(key) is int for key in keys)):
        raise ConfigError("actions are bound by name or by index, not both", key="actions")
    by_key: dict[object, Callback | Ensemble | Binding] = dict(bindings.items())
    wanted: list[object] = list(names) if keys and isinstance(keys[0], str) else list(range(len(names)))
    missing = [key for key in wanted if key not in by_key]
    unknown = [key for key in keys if key not in wanted]
    hint = f" (the actions are {', '.join(names[:20])})"
    if unknown:
        close = "".join(similar(str(key), names) for key in unknown[:1])
        raise ConfigError(
            f"no such action: {', '.join(repr(key) for key in unknown)}{close or hint}", key=f"actions.{unknown[0]}"
        )
    if missing:
        raise ConfigError(
            f"nothing is bound to the action {', '.join(repr(key) for key in missing)}: every action of the model "
            f"needs a function or an ensemble{hint}",
            key=f"actions.{missing[0]}",
        )
    result = []
    for key in wanted:
        target = by_key[key]
        try:
            result.append(target if isinstance(target, Binding) else bind(target))
        except ConfigError as error:
            raise ConfigError(error.message, key=f"actions.{key}") from None
    return tuple(result)


def safe_binding(
    safe_action: str | Callback | Binding | None, names: tuple[str, ...], bindings: tuple[Binding, ...]
) -> Binding | None:
    """Return the binding of the safe action, which is a function, a binding, or, by its name, one of the actions.

    Raises:
        ConfigError: If there is no such action, or it is an ensemble.
    """
    if safe_action is None:
        return None
    if isinstance(safe_action, str):
        if safe_action not in names:
            raise ConfigError(
                f"there is no action {safe_action!r} for safe_action; there are {', '.join(names)}", key="safe_action"
            )
        binding = bindings[names.index(safe_action)]
    else:
        binding = safe_action if isinstance(safe_action, Binding) else bind(safe_action)
    if binding.ensemble is not None:
        raise ConfigError(
            f"the safe action has to be a function: ensemble {binding.ensemble.name!r} cannot decide in a safe mode",
            key="safe_action",
        )
    return binding

"""Ceilings: the most that Zenoh lets through, by key; fixed when a session opens.

A limit that depends on the network, or counts bytes a second, is an agent's `Allowance`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from msgspec import Meta

from mdm.errors import ConfigError, Error
from mdm.options import Options
from mdm.team.transport.keys import check_expression
from mdm.team.transport.transport import Priority

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Ceiling", "ceiling_settings"]

_PRIORITIES = {"step": "real_time", "value": "data", "bulk": "background"}


class Ceiling(Options, frozen=True):
    """A ceiling on the messages under the keys of an expression, which Zenoh keeps for each link.

    Args:
        keys: An expression, such as ``mdm/rescue/*/patrol/belief``.
        rate: Messages a second at most; those between are dropped, and their receivers count them as ``missing``.
        size: Bytes of a message at most, with its envelope; larger ones are dropped.
        priority: How urgent they are, in place of their own priority.
    """

    keys: str
    rate: Annotated[float, Meta(gt=0, le=1e9, extra={"unit": "messages a second"})] | None = None
    size: Annotated[int, Meta(gt=0, extra={"unit": "bytes"})] | None = None
    priority: Priority | None = None


def ceiling_settings(ceilings: Sequence[Ceiling]) -> dict[str, Any]:
    """Return Zenoh's settings for ceilings, which count for the messages of this agent.

    Raises:
        ConfigError: If a ceiling is none, or its keys are malformed.
    """
    for place, ceiling in enumerate(ceilings):
        _check(ceiling, f"ceilings[{place}]")
    return {
        "downsampling": [
            {
                "id": f"rate {place}",
                "flows": ["egress"],
                "messages": ["put"],
                "rules": [{"key_expr": ceiling.keys, "freq": float(ceiling.rate)}],
            }
            for place, ceiling in enumerate(ceilings)
            if ceiling.rate is not None
        ],
        "low_pass_filter": [
            {
                "id": f"size {place}",
                "flows": ["egress"],
                "messages": ["put"],
                "key_exprs": [ceiling.keys],
                "size_limit": int(ceiling.size),
            }
            for place, ceiling in enumerate(ceilings)
            if ceiling.size is not None
        ],
        "qos": {
            "publication": [
                {"key_exprs": [ceiling.keys], "config": {"priority": _PRIORITIES[ceiling.priority]}}
                for ceiling in ceilings
                if ceiling.priority is not None
            ]
        },
    }


def _check(ceiling: Ceiling, key: str) -> None:
    try:
        check_expression(ceiling.keys)
    except Error as error:
        raise ConfigError(str(error), key=f"{key}.keys") from None
    if ceiling.rate is None and ceiling.size is None and ceiling.priority is None:
        raise ConfigError("a ceiling has a rate, a size or a priority", key=key)

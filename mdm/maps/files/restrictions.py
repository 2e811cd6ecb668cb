"""Restrictions of places and ways in LCAS's maps: for which robots they are.

A restriction is a text of conditions such as ``robot_short``, a kind with a value, joined by ``&``, ``|`` and ``~``.
It holds where the robot may go. A condition of a kind that nobody has told, such as ``obstacleFree_1``, is unknown.
"""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["allows"]


def allows(restriction: str, robot: Mapping[str, str]) -> bool | None:
    """Return whether a robot may go where a restriction is; None where what is told of it does not decide.

    Args:
        restriction: The text; an empty one holds for all.
        robot: What the robot is: a value for each kind, such as ``{"robot": "short"}``; capitals do not count.

    Raises:
        ValueError: If the text is none of conditions.
    """
    try:
        return _holds(ast.parse(restriction.strip() or "True", mode="eval").body, robot)
    except (SyntaxError, RecursionError, MemoryError):
        raise ValueError(restriction) from None


def _holds(part: ast.expr, robot: Mapping[str, str]) -> bool | None:
    match part:
        case ast.Constant(value=bool(known)):
            return known
        case ast.Name(id=name):
            kind, _, value = name.partition("_")
            return robot[kind].lower() == value.lower() if kind in robot else None
        case ast.UnaryOp(op=ast.Not() | ast.Invert(), operand=operand):
            inner = _holds(operand, robot)
            return None if inner is None else not inner
        case ast.BoolOp(op=joint, values=parts):
            pass
        case ast.BinOp(left=left, op=ast.BitAnd() | ast.BitOr() as joint, right=right):
            parts = [left, right]
        case _:
            raise ValueError(ast.unparse(part))
    decisive = isinstance(joint, ast.Or | ast.BitOr)  # one part that is so decides
    held = [_holds(each, robot) for each in parts]
    return decisive if decisive in held else None if None in held else not decisive

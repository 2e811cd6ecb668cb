"""The host of a page, and the certificate that it shows there, by the options of a verb."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.cli.usage import UsageError
from mdm.config import load_team_file

if TYPE_CHECKING:
    import argparse

__all__ = ["page_hosts", "refuse_without_page"]


def refuse_without_page(arguments: argparse.Namespace) -> None:
    """Refuse the options of a page where nobody asked for one.

    Raises:
        UsageError: If there are any.
    """
    for option in ("control", "host", "access"):
        if getattr(arguments, f"page_{option}", None) not in {None, False}:
            raise UsageError(f"--page-{option} is for a page: say --page, too")


def page_hosts(arguments: argparse.Namespace, name: str | None) -> dict[str, Any]:
    """Return the host and the access of a page.

    Args:
        arguments: The arguments of the verb.
        name: Whose certificate of the team is shown where none is given; None where there is no team.
    """
    from mdm.views.web.listening import LOOPBACK  # noqa: PLC0415 - an extra, and only where it is asked for

    host, access = arguments.page_host, arguments.page_access
    if host is None:
        host = LOOPBACK[0]
    if access is None and name is not None and host not in LOOPBACK:
        described = load_team_file(arguments.file)
        access = None if described is None else described.access(name)
    return {"host": host, "access": access}

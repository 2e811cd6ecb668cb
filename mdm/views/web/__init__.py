"""The live page: a server of this machine's browsers, which shows a running system or a record."""

from __future__ import annotations

from mdm.views.web.server import PORT, Page, PageServer

__all__ = ["PORT", "Page", "PageServer"]

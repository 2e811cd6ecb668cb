"""Texts that programs hand on from outside: what raises them may be in any file, and of any class."""

from __future__ import annotations

TEXTS = (
    "",
    "caf\udce9.yaml",
    "\0 and \x1b[2J",
    "<script>alert('&')</script>",
    100_000 * "x",
    "\ufeff\u202e\U0001f916",
    "%s {0}",
)
"""Behind what each says in every scenario."""

FILES = ("caf\udce9.py", "<b>.py", "plain.py")
"""Where the code is that raises."""


class Texts:
    """Makes texts and errors, of some scenarios hostile ones.

    Args:
        random: Draws them.
    """

    def __init__(self, random):
        self._random = random
        self.hostile = random.random() < 0.3

    def more(self):
        """Return what a text ends with."""
        return self._random.choice(TEXTS) if self.hostile else ""

    def throw(self, kind, text):
        """Raise an error of a kind with a text that begins so."""
        if not self.hostile:
            raise kind(text)
        if kind is ValueError and self._random.random() < 0.3:
            kind = type(self._random.choice(("Caf\xe9<b>", 200 * "X")), (ValueError,), {})
        found = {}
        exec(compile("def throw(error):\n    raise error", self._random.choice(FILES), "exec"), found)
        found["throw"](kind(text + self.more()))

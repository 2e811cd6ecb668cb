"""How wheels are built: mypyc compiles the modules that every decision goes through, which `pyproject.toml` lists.

The sources stay in the wheel: they are what is read, by people and by tracebacks. Where nothing can be compiled, as
without a C compiler, the wheel is plain Python, and one line says why. Editable installs are always plain.

The environment variable ``MDM_WHEEL`` chooses: ``plain``, or ``compiled``, which fails in place of falling back and
shows all that the compilers say.
"""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

TESTED = (3, 11)
"""The version of CPython that the whole test suite has passed with when compiled; others run the plain package."""

TOOLS = ["mypy==2.4.1", "setuptools>=65", "msgspec>=0.19", "mypy_extensions>=1.0"]
"""What compiles. Another version of mypyc writes other C: see `mended`."""

OPTIONS = ["--config-file=", "--ignore-missing-imports", "--follow-imports=silent", "--no-warn-unused-ignores"]

BORROWED = re.compile(r"\n *Py_(?:VISIT|CLEAR)\(\*\(\(PyObject \*\*\)\(\(char \*\)self \+ sizeof\(PyObject \*\) .*")
TYPE = re.compile(r'(?P<before>\.tp_name = "(?P<name>\w+)",[^;]*?\.tp_doc = )PyDoc_STR\((?P<told>NULL|".*")\)')
FUNCTION = re.compile(r'(?P<before>CPyPy_\w+?___(?P<name>\w+),\s+METH_[A-Z_| ]+, )PyDoc_STR\((?P<told>NULL|".*")\)')
FREED = re.compile(r"\n *CPy_TRASHCAN_BEGIN\(self, \w+\)")


class CompiledWheel(BuildHookInterface):  # type: ignore[type-arg]
    """Adds compiled modules to a wheel, beside their sources."""

    _folder: str | None = None

    def dependencies(self) -> list[str]:
        """Return what has to be installed to build."""
        return TOOLS if _reason_to_be_plain() is None else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile; tell in one line where that was not possible."""
        if version == "editable":
            return
        reason = _reason_to_be_plain()
        if reason is None:
            self._folder = tempfile.mkdtemp(prefix="mdm-wheel-")
            reason = self._compile(Path(self._folder), build_data)
        if reason is not None and os.environ.get("MDM_WHEEL") == "compiled":
            raise RuntimeError(f"mdm could not be compiled: {reason}")
        if reason is not None:
            self.app.display_warning(f"mdm is built as plain Python, whose decisions take longer: {reason}")

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:  # noqa: ARG002
        """Remove what the compilers have left."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _compile(self, folder: Path, build_data: dict[str, Any]) -> str | None:
        """Compile a copy of the package and include what comes of it; return why that was not possible, if so."""
        without = shutil.ignore_patterns("__pycache__", "*.so")
        shutil.copytree(Path(self.root, "mdm"), folder / "mdm", ignore=without)
        command = [sys.executable, str(Path(__file__).resolve()), *self.config["modules"]]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)  # noqa: S603
        if done.returncode:
            if os.environ.get("MDM_WHEEL") == "compiled":
                return f"\n{done.stdout}\n{done.stderr}"
            return (done.stderr.strip() or done.stdout.strip()).rpartition("\n")[2]
        for library in folder.glob("mdm__mypyc.*"):
            build_data["force_include"][str(library)] = library.name
        for module in (folder / "mdm").rglob("*.so"):
            build_data["force_include"][str(module)] = str(module.relative_to(folder))
        build_data["pure_python"] = False
        build_data["infer_tag"] = True
        return None


def _reason_to_be_plain() -> str | None:
    """Return why nothing is compiled whatever there is to do it; None if there is no reason."""
    wanted = os.environ.get("MDM_WHEEL")
    if wanted not in {None, "", "plain", "compiled"}:
        raise ValueError(f"the environment variable MDM_WHEEL is 'plain' or 'compiled', not {wanted!r}")
    if wanted == "plain":
        return "MDM_WHEEL is 'plain'"
    if sys.implementation.name != "cpython" or sys.version_info[:2] != TESTED:
        return f"compiled it is tested with CPython {TESTED[0]}.{TESTED[1]} alone"
    return None


def documented(source: str, modules: list[str]) -> str:
    """Return C that mypyc has written, with the docstrings of classes and functions, which it leaves out."""
    texts: dict[str, str] = {}

    def read(nodes: list[ast.stmt], above: str) -> None:
        for node in nodes:
            if isinstance(node, ast.ClassDef | ast.FunctionDef):
                texts[above + node.name] = ast.get_docstring(node) or ""
            if isinstance(node, ast.ClassDef):
                read(node.body, f"{node.name}___")

    for module in modules:
        read(ast.parse(Path(module).read_text(encoding="utf-8")).body, "")

    def document(found: re.Match[str]) -> str:
        text = texts.get(found["name"], "")
        written = "".join(f"\\{byte:03o}" if byte in b'"?\\\n' or byte > 126 else chr(byte) for byte in text.encode())
        return f'{found["before"]}PyDoc_STR({"" if found["told"] == "NULL" else found["told"]} "{written}")'

    return FUNCTION.sub(document, TYPE.sub(document, source))


def mended(source: str) -> str:
    """Return C that mypyc has written, with weak references that are safe.

    A class that inherits from one that is not compiled can be held weakly. On CPython 3.11 mypyc takes the list of an
    object's weak references for its own, and lets them dangle when the object is gone; so they are left alone until
    then, and cleared first.

    Raises:
        ValueError: If the C is not as expected.
    """
    source, borrowed = BORROWED.subn("", source)
    clear = r"\g<0>\n    if (Py_TYPE(self)->tp_weaklistoffset) PyObject_ClearWeakRefs((PyObject *)self);"
    source, freed = FREED.subn(clear, source)
    if not borrowed or not freed:
        raise ValueError("mypyc has written C of another form than is known")
    return source


def compile_here(modules: list[str]) -> None:
    """Compile modules of the package in the working directory, beside their sources."""
    from setuptools import Extension, setup  # noqa: PLC0415 - only where something is compiled

    def build(*extensions: Extension) -> None:
        setup(name="mdm", ext_modules=[*extensions], script_args=["--quiet", "build_ext", "--inplace"])

    Path("probe.c").write_text("#include <Python.h>\nPyMODINIT_FUNC PyInit_probe(void) { return NULL; }\n")
    build(Extension("probe", ["probe.c"]))  # before mypyc takes its time: is there a compiler at all?

    from mypyc.build import mypycify  # noqa: PLC0415 - which imports all of mypy

    extensions = mypycify([*OPTIONS, *modules], opt_level="3", debug_level="0", group_name="mdm")
    for path in {Path(source) for extension in extensions for source in extension.sources}:
        if path.name.startswith("__native"):
            path.write_text(documented(mended(path.read_text()), modules))
    build(*extensions)


if __name__ == "__main__":
    compile_here(sys.argv[1:])

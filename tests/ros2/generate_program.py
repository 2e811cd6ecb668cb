"""Generates Python's messages of a package from definitions given as text, by the generators among rclpy's wheels.

Its arguments: the package's name, the folder that it comes into, and JSON of the definitions by path, such as
``{"action/Dock.action": "string dock_id\\n---\\n---\\n"}``. It needs gcc and g++, and takes some ten seconds.
"""

import json
import subprocess
import sys
import sysconfig
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import rosidl_generator_c
import rosidl_generator_py
import rosidl_generator_type_description
import rosidl_typesupport_c
import rosidl_typesupport_fastrtps_c
from rosidl_adapter.action import convert_action_to_idl

PREFIX = Path(sys.prefix)
TYPESUPPORT = "rosidl_typesupport_c"


def idl(package, folder, definitions):
    """Write definitions as files, and as the IDL that the generators read; return their paths."""
    for path, text in definitions.items():
        written = folder / path
        written.parent.mkdir(parents=True, exist_ok=True)
        written.write_text(text)
        convert_action_to_idl(folder, package, Path(path), written.parent)
    return [str(Path(path).with_suffix(".idl")) for path in definitions]


def arguments(package, work, name, paths, described):
    """Write the file of arguments that a generator reads."""
    output = work / name / package
    output.mkdir(parents=True, exist_ok=True)
    file = work / f"{name}.json"
    file.write_text(
        json.dumps(
            {
                "package_name": package,
                "output_dir": str(output),
                "template_dir": str(PREFIX / "share" / name / "resource"),
                "idl_tuples": [f"{work / 'idl'}:{path}" for path in paths],
                "ros_interface_dependencies": [],
                "target_dependencies": [],
                "type_description_tuples": described,
                "ros_interface_files": [],
                "include_paths": [f"{each.name}:{each}" for each in (PREFIX / "share").iterdir() if each.is_dir()],
            }
        )
    )
    for template in (PREFIX / "share" / name / "resource").glob("*visibility_control.h.in"):
        text = template.read_text().replace("@PROJECT_NAME_UPPER@", package.upper()).replace("@PROJECT_NAME@", package)
        header = output / "msg" / template.stem
        header.parent.mkdir(exist_ok=True)
        header.write_text(text)
    return file


def compiled(package, work, target, sources):
    """Compile all that was generated into the one module that Python imports."""
    names = ["rosidl_generator_c", "rosidl_typesupport_fastrtps_c", "rosidl_generator_py"]
    folders = [work / name for name in names]
    folders += [each for each in (PREFIX / "include").iterdir() if each.is_dir()]
    folders += [sysconfig.get_path("include"), np.get_include()]
    given = [f"-I{folder}" for folder in (*folders, PREFIX / "include")]

    def build(source):
        compiler = ["g++", "-std=c++17"] if source.suffix == ".cpp" else ["gcc"]
        built = source.with_suffix(f"{source.suffix}.o")
        subprocess.run([*compiler, "-O0", "-w", "-fPIC", *given, "-c", source, "-o", built], check=True)
        return built

    with ThreadPoolExecutor(2) as pool:
        built = list(pool.map(build, sources))
    packages = [
        "builtin_interfaces",
        *(f"{it}_msgs" for it in ("action", "geometry", "service", "std", "unique_identifier")),
    ]
    kinds = ("generator_c", "generator_py", "typesupport_c", "typesupport_fastrtps_c")
    runtime = "rosidl_runtime_c rosidl_typesupport_c rosidl_typesupport_fastrtps_c rosidl_typesupport_fastrtps_cpp"
    libraries = [f"{name}__rosidl_{kind}" for name in packages for kind in kinds]
    libraries += [*runtime.split(), "fastcdr", "rcutils", "rmw"]
    module = target / f"{package}_s__{TYPESUPPORT}.so"
    linked = [f"-l{name}" for name in libraries if (PREFIX / "lib" / f"lib{name}.so").exists()]
    subprocess.run(
        ["g++", "-shared", *built, f"-L{PREFIX / 'lib'}", f"-Wl,-rpath,{PREFIX / 'lib'}", *linked, "-o", module],
        check=True,
    )


def main():
    package, folder, definitions = sys.argv[1], Path(sys.argv[2]), json.loads(sys.argv[3])
    work = folder / "build"
    paths = idl(package, work / "idl", definitions)
    hashes = "rosidl_generator_type_description"
    rosidl_generator_type_description.generate_type_hash(str(arguments(package, work, hashes, paths, [])))
    described = [f"{path}:{(work / hashes / package / path).with_suffix('.json')}" for path in paths]
    sources = []
    for name, generate in (
        ("rosidl_generator_c", rosidl_generator_c.generate_c),
        ("rosidl_typesupport_fastrtps_c", rosidl_typesupport_fastrtps_c.generate_typesupport_fastrtps_c),
        (
            "rosidl_typesupport_c",
            lambda file: rosidl_typesupport_c.generate_c(file, ["rosidl_typesupport_fastrtps_c"]),
        ),
        ("rosidl_generator_py", lambda file: rosidl_generator_py.generate_py(file, [TYPESUPPORT])),
    ):
        made = generate(str(arguments(package, work, name, paths, described)))
        sources += [Path(each) for each in made if each.endswith((".c", ".cpp"))]
    generated = work / "rosidl_generator_py" / package
    sources += [each for each in generated.glob("*.c") if each not in sources]
    target = folder / package
    target.mkdir()
    (target / "__init__.py").touch()
    for each in generated.rglob("*.py"):
        (target / each.relative_to(generated)).parent.mkdir(exist_ok=True)
        (target / each.relative_to(generated)).write_text(each.read_text())
    compiled(package, work, target, sources)


main()

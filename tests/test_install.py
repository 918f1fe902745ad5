"""What is installed: environments alone, the rest by extras that are named where they are missing; equal wheels."""

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib import import_module, metadata
from pathlib import Path

import pytest

import impact_envs
from impact_envs import command
from impact_envs.interface import extras
from train.cli.main import COMMANDS, main

ROOT = Path(__file__).parents[1]
PACKAGES = ("impact_envs", "planners", "agents", "train")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
MODULES = {
    "pygame-ce": "pygame",
    "pillow": "PIL",
    "ray[rllib]": "ray",
    "minari[hdf5]": "minari",
    "numba-cuda[cu12]": "numba",
}
# Of the standard library, of the packages themselves, or brought by what is declared and used only beside it.
BROUGHT = {*sys.stdlib_module_names, *PACKAGES, "benchmarl", "gurobipy", "pyscipopt"}


def name_modules(requirements):
    names = [re.match(r"[\w.-]+(\[\w+\])?", requirement)[0] for requirement in requirements]
    return {MODULES.get(name, name.replace("-", "_")) for name in names}


def list_imports(package, top_level=False):
    """Return the roots of all modules that a package imports, or of those that it imports when it is imported."""
    found = {}
    for path in (ROOT / package).rglob("*.py"):
        tree = ast.parse(path.read_text())
        for node in tree.body if top_level else ast.walk(tree):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.level == 0 else []
            found |= {name.partition(".")[0]: path.name for name in names}
    return found


@pytest.mark.parametrize("package", PACKAGES)
def test_what_is_imported_is_declared(package):
    declared = name_modules(PROJECT["dependencies"])
    for listed in PROJECT["optional-dependencies"].values():
        declared |= name_modules(listed)
    undeclared = {name: file for name, file in list_imports(package).items() if name not in declared | BROUGHT}
    assert not undeclared


def test_environments_need_no_extra():
    """Of what an extra brings, the environments import at most inside functions, or in a module of that library."""
    needed = {
        name: file
        for name, file in list_imports("impact_envs", top_level=True).items()
        if name not in name_modules(PROJECT["dependencies"]) | BROUGHT
    }
    assert set(needed.values()) <= {"torchrl.py", "benchmarl.py", "gpu.py"}, needed
    heavy = {"torch", "stable_baselines3", "casadi", "cvxpy", "plotly", "matplotlib"}
    assert not heavy & name_modules(PROJECT["dependencies"])


def test_version_and_types_are_there():
    assert re.fullmatch(r"\d+\.\d+\.\d+", impact_envs.__version__)
    assert f"version: {impact_envs.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    assert all((ROOT / package / "py.typed").is_file() for package in PACKAGES)


def test_the_extra_that_is_missing_is_named(monkeypatch, capsys, tmp_path):
    """From the source, whose metadata may be of an older install, and from the metadata of a wheel."""
    listed = PROJECT["optional-dependencies"]
    told = [f'{requirement} ; extra == "{extra}"' for extra, all_of in listed.items() for requirement in all_of]
    wanted = {
        "torch.nn": ["learn"],
        "stable_baselines3": ["learn"],
        "highspy": ["plan"],
        "imageio_ffmpeg": ["report"],
        "PIL.GifImagePlugin": ["report"],
        "pandas": ["learn", "report"],
        "ray": ["ray"],
        "numpy": [],
        "nothing": [],
    }
    monkeypatch.setattr(metadata, "requires", lambda name: ["numpy>=1"])  # of an older install
    assert {module: extras.find_extras(module) for module in wanted} == wanted
    with monkeypatch.context() as installed:
        installed.setattr(metadata, "requires", lambda name: [*PROJECT["dependencies"], *told])
        installed.setattr(extras, "SOURCE", tmp_path / "pyproject.toml")  # not there
        assert {module: extras.find_extras(module) for module in wanted} == wanted
    monkeypatch.setitem(sys.modules, "minari", None)
    assert main(("dataset", "throw_and_catch")) == 2
    assert capsys.readouterr().err == "impact: minari is not installed: pip install 'impact-envs[plan,learn]'\n"
    monkeypatch.setitem(sys.modules, "imageio.v2", None)
    assert main(("run", "throw_and_catch", "--policy", "zero", "--render", str(tmp_path / "a.mp4"))) == 2
    assert "pip install 'impact-envs[plan,report]'" in capsys.readouterr().err


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_says_which_extras_it_needs(name):
    needed = import_module(f"train.cli.{name}").Command.extras
    assert set(needed) <= PROJECT["optional-dependencies"].keys()


def test_own_packages_go_first_only_where_their_names_are_taken(monkeypatch, tmp_path):
    before = [str(ROOT), *sys.path]
    monkeypatch.setattr(sys, "path", list(before))
    command.prefer_own_packages()
    assert sys.path == before
    (tmp_path / "train.py").write_text("")
    sys.path.insert(0, str(tmp_path))
    command.prefer_own_packages()
    assert sys.path == [str(ROOT), str(tmp_path), *before]


@pytest.mark.parametrize(
    "arguments",
    [
        ("list",),
        pytest.param(
            ("evaluate", "throw_and_catch", "--policies", "zero", "random", "--episodes", "1", "--workers", "2"),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_command_works_beside_modules_of_the_same_names(tmp_path, arguments):
    for place in ("train.py", "agents/__init__.py", "planners/__init__.py"):
        (tmp_path / place).parent.mkdir(exist_ok=True)
        (tmp_path / place).write_text("raise SystemExit('this one is the user’s own')")
    script = f"import sys; sys.path.append({str(ROOT)!r}); from impact_envs.command import main; sys.exit(main())"
    said = subprocess.run(
        [sys.executable, "-c", script, *arguments, "--json"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": "."},
    )
    assert said.returncode == 0, said.stderr
    json.loads(said.stdout)


def build_wheel(folder, epoch="1700000000"):
    """Build a wheel from a copy of what the distribution consists of."""
    source = folder / "source"
    skipped = shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc")
    for package in PACKAGES:
        shutil.copytree(ROOT / package, source / package, ignore=skipped)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    arguments = ("wheel", "-q", "--no-deps", "--no-build-isolation", "-w", str(folder / "dist"), str(source))
    subprocess.run(
        [sys.executable, "-m", "pip", *arguments], check=True, env={**os.environ, "SOURCE_DATE_EPOCH": epoch}
    )
    (wheel,) = (folder / "dist").glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    return build_wheel(tmp_path_factory.mktemp("wheel"))


def _forget_tree():
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


def make_venv(folder, wheel, *arguments):
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    install = ("install", "-q", "--disable-pip-version-check", *arguments, str(wheel))
    subprocess.run([str(folder / "bin" / "pip"), *install], check=True, env=_forget_tree())
    return folder / "bin"


def call(program, *arguments, folder, code=0):
    """Run a program outside the tree, and return what it said."""
    said = subprocess.run([str(program), *arguments], capture_output=True, text=True, cwd=folder, env=_forget_tree())
    assert said.returncode == code, said.stderr
    return said


@pytest.mark.slow
def test_two_builds_are_one_wheel(wheel, tmp_path):
    assert build_wheel(tmp_path).read_bytes() == wheel.read_bytes()


@pytest.mark.slow
def test_the_wheel_does_the_main_job(wheel, tmp_path):
    """Installed beside the dependencies of these tests; the first run compiles for minutes."""
    bin_folder = make_venv(tmp_path / "venv", wheel, "--no-deps")
    (library,) = (tmp_path / "venv" / "lib").glob("python3*/site-packages")
    sites = [path for path in sys.path if path.endswith("site-packages")]
    (library / "tests.pth").write_text("\n".join(sites) + "\n")
    work = tmp_path / "work"
    work.mkdir()
    (work / "train.py").write_text("raise SystemExit('not this one')")
    where = call(bin_folder / "python", "-c", "import impact_envs; print(impact_envs.__file__)", folder=work).stdout
    assert where.startswith(str(library))
    said = call(bin_folder / "impact", "demo", "--episodes", "2", "--json", folder=work)
    told = json.loads(said.stdout)
    assert all(row["success_rate"] == 1.0 for row in told["rows"] if row["policy"] == "expert")
    assert (work / "report" / "report.html").is_file()


@pytest.mark.slow
def test_the_environments_alone_are_light(wheel, tmp_path):
    """Installed with what the registry has within the pins: no learner, no optimiser, no plots."""
    bin_folder = make_venv(tmp_path / "venv", wheel, "--no-compile", "--constraint", str(ROOT / "constraints.txt"))
    (library,) = (tmp_path / "venv" / "lib").glob("python3*/site-packages")
    for heavy in ("torch", "stable_baselines3", "casadi", "cvxpy", "plotly", "matplotlib", "scipy", "pandas"):
        assert not (library / heavy).exists()
    skipped = ("pip", "setuptools", "pkg_resources", "_distutils_hack")
    files = [path for path in library.rglob("*") if path.is_file() and not path.is_symlink()]
    counted = [path for path in files if path.relative_to(library).parts[0] not in skipped]
    size = sum(path.stat().st_size for path in counted if path.suffix != ".pyc")
    assert size < 300 * 2**20, size  # more than half of it is the compiler
    program = "import impact_envs; print(impact_envs.parallel_env('dual_arm_grasp').reset(seed=0)[0]['arm_1'].shape)"
    assert call(bin_folder / "python", "-c", program, folder=tmp_path).stdout == "(31,)\n"
    assert "corridor" in call(bin_folder / "impact", "list", folder=tmp_path).stdout
    for arguments, extra in (
        (("plan", "corridor"), "plan"),
        (("evaluate", "corridor"), "plan,report"),
        (("train", "corridor"), "plan,learn"),
    ):
        line = call(bin_folder / "impact", *arguments, folder=tmp_path, code=2).stderr.strip()
        assert re.fullmatch(rf"impact: \w+ is not installed: pip install 'impact-envs\[{extra}\]'", line)

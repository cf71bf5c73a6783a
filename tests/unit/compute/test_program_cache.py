"""Programs kept on disk: the same bits as compiled anew, by any number of processes, and nothing
is run that another user could have written."""

import os
import subprocess
import sys
from pathlib import Path
from threading import Thread

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difffric as df
from difffric.compute.program_cache import cache_program
from difffric.compute.programs import private_folder, store
from difffric.compute.programs.private_folder import FOLDER

ROOT = Path(__file__).parents[3]
RIG = df.spring_damper_rig(mass=18.9, mu_s=0.141, mu_k_over_mu_s=0.75, k_v=5.0, k=8e5, b=1500.0)

needs_users = pytest.mark.skipif(not hasattr(os, "getuid"), reason="files have no owner here")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    root = tmp_path / "programs"
    monkeypatch.setenv(FOLDER, str(root))
    yield root
    store.find_folder.cache_clear()


@pytest.fixture
def package(tmp_path):
    """A package with a law two folders down."""
    law = tmp_path / "package" / "rig" / "laws" / "friction.py"
    law.parent.mkdir(parents=True)
    law.write_text("mu_k = 0.75\n", encoding="utf-8")
    return law


def test_a_law_changed_two_folders_down_makes_another_program(folder, package, monkeypatch):
    monkeypatch.setattr(store, "_PACKAGE", package.parents[2])
    before = store._name_version()
    assert store._name_version() == before
    package.write_text("mu_k = 0.8\n", encoding="utf-8")
    changed = store._name_version()
    package.rename(package.with_name("contact.py"))
    assert len({before, changed, store._name_version()}) == 3


def test_the_package_that_makes_a_program_is_this_one():
    assert {"__init__.py", "program_cache.py"} <= {p.name for p in store._PACKAGE.rglob("*.py")}


def files_of(root):
    return sorted(path for path in root.rglob("*") if path.is_file())


def counted():
    """(a kept function, how often it was traced)."""
    traced = []

    def function(x, tree):
        traced.append(1)
        return {"sum": jnp.sin(x) * tree[0], "first": tree[1][0]}

    return cache_program(function), traced


ARGUMENTS = np.linspace(0.0, 1.0, 5), (2.0, (np.arange(3.0),))


def equal(a, b):
    return all(np.array_equal(a[k], b[k], equal_nan=True) for k in a) and a.keys() == b.keys()


def test_a_program_from_the_disk_gives_the_same_and_is_not_traced(folder):
    first, traced = counted()
    wanted = first.jitted(*ARGUMENTS)
    traced.clear()
    assert equal(first(*ARGUMENTS), wanted) and len(traced) == 1
    assert equal(first(*ARGUMENTS), wanted) and len(traced) == 1
    other, traced = counted()
    assert equal(other(*ARGUMENTS), wanted) and not traced
    assert len(files_of(folder)) == 1


def test_another_kind_of_argument_is_another_program(folder):
    function, traced = counted()
    function(*ARGUMENTS)
    x, tree = ARGUMENTS
    others = (x[:3], tree), (x, (3.0, tree[1])), (x, (2, tree[1])), (x.astype(int), tree)
    for arguments in others:
        expected = function.jitted(*arguments)
        traced.clear()
        assert equal(function(*arguments), expected) and len(traced) == 1
    assert len(files_of(folder)) == 5


def test_without_a_folder_nothing_is_kept(folder, monkeypatch):
    monkeypatch.delenv(FOLDER)
    function, traced = counted()
    function(*ARGUMENTS)
    assert traced and not folder.exists()


def test_a_kind_of_class_that_the_key_does_not_know_is_not_kept(folder):
    class Mine(tuple):
        pass

    jax.tree_util.register_pytree_node(Mine, lambda x: (list(x), None), lambda _, x: Mine(x))
    result = cache_program(lambda m: m[0] + 1.0)(Mine([np.ones(2)]))
    assert np.array_equal(result, [2.0, 2.0]) and not files_of(folder)


@pytest.mark.parametrize("damage", ["torn", "changed", "nothing", "others"])
def test_what_is_damaged_or_others_may_write_is_made_anew(folder, damage):
    function, _ = counted()
    wanted = function(*ARGUMENTS)
    (path,) = files_of(folder)
    content = path.read_bytes()
    if damage == "others":
        path.chmod(0o666)
    else:
        middle = len(content) // 2
        changed = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
        bad = {"torn": content[:middle], "changed": changed, "nothing": b""}[damage]
        path.write_bytes(bad)
    other, traced = counted()
    assert equal(other(*ARGUMENTS), wanted) and traced
    third, traced = counted()
    assert equal(third(*ARGUMENTS), wanted) and not traced


def test_another_version_has_a_folder_of_its_own(folder, monkeypatch):
    counted()[0](*ARGUMENTS)
    monkeypatch.setattr(store, "_name_version", lambda: "another")
    store.find_folder.cache_clear()
    function, traced = counted()
    function(*ARGUMENTS)
    assert traced and len(files_of(folder)) == 2


SOLVE = """
import sys
import jax
import jax
import jax.numpy as jnp
import numpy as np
from difffric.compute.program_cache import cache_program
traced = []
def solve(a, b):
    traced.append(1)
    return jnp.linalg.solve(a @ a.T, b), jnp.linalg.eigh(a @ a.T)[0]
a = np.arange(9.0).reshape(3, 3) + np.eye(3)
x, w = cache_program(solve)(a, a[0])
print(len(traced), float(x @ x), float(w.sum()))
"""


def test_a_program_that_calls_lapack_runs_in_a_process_that_has_compiled_none(folder):
    call = [sys.executable, "-c", SOLVE]
    told = [subprocess.run(call, capture_output=True, text=True, timeout=120) for _ in range(2)]
    assert [run.returncode for run in told] == [0, 0]
    first, second = (run.stdout.split() for run in told)
    assert (first[0], second[0]) == ("1", "0") and first[1:] == second[1:]


def test_a_program_that_calls_python_is_not_kept(folder):
    """It holds an address of the process that compiled it."""

    def called(x):
        shape = jax.ShapeDtypeStruct(x.shape, x.dtype)
        return jax.pure_callback(lambda x: np.asarray(x) + 1.0, shape, x)

    assert np.array_equal(cache_program(called)(np.zeros(2)), [1.0, 1.0])
    assert not files_of(folder)


def test_a_program_that_has_ended_two_processes_is_not_run_again(folder):
    wanted = counted()[0](*ARGUMENTS)
    (path,) = files_of(folder)
    for expected in (0, 0, 1):
        function, traced = counted()
        assert equal(function(*ARGUMENTS), wanted) and len(traced) == expected
        ended = subprocess.Popen([sys.executable, "-c", ""])
        ended.wait()
        path.with_name(f"{path.name}.first-{ended.pid}").touch()


@pytest.mark.parametrize("kept", [True, False])
def test_a_program_made_ready_is_the_one_that_is_called(folder, monkeypatch, kept):
    if not kept:
        monkeypatch.delenv(FOLDER)
    function, traced = counted()
    making = [Thread(target=function.prepare, args=ARGUMENTS) for _ in range(3)]
    for thread in making:
        thread.start()
    for thread in making:
        thread.join()
    result = function(*ARGUMENTS)
    assert len(traced) == 1 and equal(result, function.jitted(*ARGUMENTS))
    assert len(files_of(folder)) == kept


def test_processes_that_ask_at_once_make_a_program_once(folder):
    call = [sys.executable, "-c", SOLVE]
    both = [subprocess.Popen(call, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    told = [run.communicate(timeout=120)[0].split() for run in both]
    assert sorted(words[0] for words in told) == ["0", "1"] and told[0][1:] == told[1][1:]
    assert len(files_of(folder)) == 1


HOLD = """
import sys, time
from pathlib import Path
from difffric.compute.programs.private_folder import hold
with hold(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(100)
"""


def test_a_lock_is_held_by_one_and_freed_by_its_end(tmp_path, monkeypatch):
    path = tmp_path / "program.lock"
    other = subprocess.Popen([sys.executable, "-c", HOLD, path], stdout=subprocess.PIPE, text=True)
    assert other.stdout.readline() == "held\n"
    with monkeypatch.context() as patch:
        patch.setattr(private_folder, "_PATIENCE", 0.1)
        assert private_folder._lock(path) is None
    other.stdout.close()
    other.kill()
    with private_folder.hold(path):
        assert path.exists()
    assert not path.exists()
    other.wait()


def loops(x):
    """Fusions, a loop, a product of matrices, a branch."""

    def step(_, x):
        return jnp.sin(x @ x.T) + jax.lax.cond(x[0, 0] > 0, jnp.exp, jnp.cos, x)

    y = jax.lax.fori_loop(0, 3, step, x)
    return {"sum": y.sum(), "whole": y}


def test_a_stripped_program_is_smaller_and_gives_the_same(folder, monkeypatch):
    x = np.linspace(-1.0, 1.0, 16).reshape(4, 4)

    def make():
        """As a user's programs are made; the tests' own hold less that can be stripped."""
        return cache_program(loops, {"xla_cpu_use_fusion_emitters": True})

    wanted = make().jitted(x)
    contents = {}
    for stripped in (True, False):
        monkeypatch.setattr(store, "_STRIPPED", stripped)
        for _ in range(2):  # as it was made, and as it is found
            assert equal(make()(x), wanted)
        (path,) = files_of(folder)
        contents[stripped] = path.read_bytes()
        path.unlink()
    assert len(contents[True]) < 0.8 * len(contents[False])
    source = Path(__file__).name.encode()
    assert source in contents[False] and source not in contents[True]


def refuse(executable):
    raise ValueError("not laid out so")


@pytest.mark.parametrize("edit", [refuse, lambda executable: executable[:-9], lambda _: b""])
def test_a_program_that_cannot_be_stripped_is_kept_whole(folder, monkeypatch, edit):
    monkeypatch.setattr(store, "strip", edit)
    function, _ = counted()
    wanted = function(*ARGUMENTS)
    assert len(files_of(folder)) == 1
    other, traced = counted()
    assert equal(other(*ARGUMENTS), wanted) and not traced


def test_a_stripped_program_that_gives_something_else_is_not_kept(folder, monkeypatch):
    monkeypatch.setattr(store, "_same", lambda a, b: False)
    function, _ = counted()
    assert equal(function(*ARGUMENTS), function.jitted(*ARGUMENTS)) and not files_of(folder)


def test_observables_are_those_of_the_library_without_it(folder, monkeypatch):
    kept_ = df.observe(RIG, 0.05)
    again = df.observe(RIG, 0.05)
    monkeypatch.delenv(FOLDER)
    plain = df.observe(RIG, 0.05)
    for a, b, c in zip(kept_, again, plain, strict=True):
        assert np.array_equal(a, b, equal_nan=True) and np.array_equal(a, c, equal_nan=True)


@needs_users
def test_a_folder_that_others_may_write_is_refused(tmp_path, monkeypatch, capsys):
    assert private_folder.make_private(tmp_path / "new" / "folder")
    assert (tmp_path / "new" / "folder").stat().st_mode & 0o777 == 0o700
    shared = tmp_path / "shared"
    shared.mkdir()
    for mode in (0o720, 0o702, 0o777):
        shared.chmod(mode)
        assert not private_folder.make_private(shared)
    shared.chmod(0o755)
    assert private_folder.make_private(shared)
    (tmp_path / "link").symlink_to(shared)
    assert not private_folder.make_private(tmp_path / "link")
    (tmp_path / "file").touch()
    assert not private_folder.make_private(tmp_path / "file" / "below")
    monkeypatch.setenv(FOLDER, str(shared))
    uid = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: uid + 1)
    assert not private_folder.make_private(shared)
    function, _ = counted()
    function(*ARGUMENTS)
    assert "compiled programs are not kept" in capsys.readouterr().err
    assert not files_of(shared)
    store.find_folder.cache_clear()


def test_what_a_killed_process_may_have_left_is_swept(tmp_path):
    """Only that: what is older stays, and so does what a running process writes."""
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    old, mark, torn = (tmp_path / n for n in ("old", f".difffric-{ended.pid}", "torn"))
    for second, path in enumerate((old, mark, torn)):
        path.touch()
        os.utime(path, (1e9 + second, 1e9 + second))
    private_folder.sweep(tmp_path)
    own = tmp_path / f".difffric-{os.getpid()}"
    assert set(tmp_path.iterdir()) == {old, own}
    (tmp_path / "new").touch()
    private_folder.sweep(tmp_path)
    assert (tmp_path / "new").exists()


def command(*arguments, **environment):
    unset = ("JAX_COMPILATION_CACHE_DIR", FOLDER)
    rest = {k: x for k, x in os.environ.items() if k not in unset}
    return subprocess.Popen(
        [sys.executable, "-m", "difffric.commands.main", *arguments],
        cwd=ROOT, env=rest | environment,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


FIT = ("fit", "examples/slides.csv", "--setup", "examples/setup.toml", "--quiet")
IDENTIFY = ("identify", "examples/slides.csv", "--setup", "examples/setup.toml", "--quiet")


@needs_users
def test_processes_at_once_share_a_cache_and_a_foreign_one_is_not_touched(tmp_path):
    both = [command(*FIT, XDG_CACHE_HOME=str(tmp_path / "own")) for _ in range(2)]
    told = [run.communicate(timeout=300) for run in both]
    assert told[0] == told[1] and told[0][1] == ""
    assert len(files_of(tmp_path / "own" / "difffric" / "programs")) == 1
    assert not list((tmp_path / "own" / "difffric" / "jax").glob(".difffric-*"))
    foreign = tmp_path / "foreign" / "difffric"
    for name in ("jax", "programs"):
        (foreign / name).mkdir(parents=True)
        (foreign / name).chmod(0o777)
    run = command(*FIT, XDG_CACHE_HOME=str(tmp_path / "foreign"))
    out, err = run.communicate(timeout=300)
    assert run.returncode == 0 and out == told[0][0]
    assert len(err.splitlines()) == 2 and err.count(private_folder.REFUSED) == 2
    # How long work took is kept in the folder around them, which is the user's own, where it took
    # long enough to be told the next time.
    assert {path.name for path in files_of(foreign)} <= {"durations.json"}


def test_a_command_that_draws_nothing_loads_no_matplotlib():
    code = (
        "import sys\nfrom difffric.commands.main import app\n"
        f"app({list(IDENTIFY)!r}, standalone_mode=False)\n"
        "sys.exit(bool({'matplotlib', 'optimistix', 'jinja2', 'nptdms'} & {*sys.modules}))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True)
    assert done.returncode == 0

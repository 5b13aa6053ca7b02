"""The command line, run as a user runs it."""

from __future__ import annotations

import builtins
import subprocess
import sys
from functools import partial

import numpy as np
import pytest

import fastatt as fa
from fastatt import cli
from fastatt.__main__ import main as start
from fastatt.cli import main
from fastatt.trade.recordings import compare_on_log
from fastatt.trade.scene_file import read_scene


@pytest.fixture
def log(tmp_path):
    t = 0.01 * np.arange(400)
    rates = np.stack([np.sin(t), np.cos(2 * t), 0.3 + 0 * t], axis=1)
    path = tmp_path / "log.csv"
    head = "Time (s),Gyr_X (rad/s),Gyr_Y (rad/s),Gyr_Z (rad/s)"
    np.savetxt(
        path, np.column_stack([t, rates]), delimiter=",", header=head, comments="", fmt="%.17g"
    )
    return path, t, rates


@pytest.mark.parametrize("suffix", [".csv", ".npy"])
def test_integrate(log, tmp_path, capsys, suffix):
    path, t, rates = log
    out = tmp_path / f"out{suffix}"
    arguments = ["-o", str(out), "-m", "coning3"]
    assert main(["integrate", str(path), *arguments]) == 0
    found = np.load(out) if suffix == ".npy" else np.loadtxt(out, delimiter=",", skiprows=1)
    expected = fa.integrate_rates(rates, np.diff(t), method="coning3")
    assert np.array_equal(found[:, 1:], expected)
    assert found[:, 0] == pytest.approx(t, abs=1e-15)
    text = capsys.readouterr().out
    assert "400 samples at 100 Hz (time stamps in Time (s))" in text
    assert "400 attitudes by coning3" in text
    assert "error of" not in text


def test_time_stamps_in_another_unit(tmp_path, capsys):
    """A unit that is not said is told, or refused with the option that says it."""
    path = tmp_path / "log.csv"
    rows = "\n".join(f"{5_000_000 * i},0.1,0.2,0.3" for i in range(9))
    path.write_text(f"time,gyro_x,gyro_y,gyro_z\n{rows}\n", encoding="utf-8")
    assert main(["integrate", str(path)]) == 0
    found = capsys.readouterr()
    assert "time has no unit: taken as ns (200 Hz)" in found.err
    assert "9 samples at 200 Hz" in found.out
    path.write_text("time,gyro_x,gyro_y,gyro_z\n0,1,2,3\n1,1,2,3\n2,1,2,3\n", encoding="utf-8")
    assert main(["integrate", str(path)]) == 2
    assert "time_unit (1 Hz in s or 1000 Hz in ms" in capsys.readouterr().err
    assert main(["integrate", str(path), "--time-unit", "ms"]) == 0
    assert "3 samples at 1000 Hz" in capsys.readouterr().out


@pytest.mark.parametrize("start", [0.0, 12.5, 1.7e9])
def test_unix_stamps_are_kept(tmp_path, start):
    path, out = tmp_path / "log.csv", tmp_path / "out.npy"
    rows = "\n".join(f"{start + 0.01 * i:.2f},0.1,0.2,0.3" for i in range(50))
    path.write_text(f"time (s),gyro_x,gyro_y,gyro_z\n{rows}\n", encoding="utf-8")
    assert main(["integrate", str(path), "-u", "rad/s", "-o", str(out)]) == 0
    begin = start if start > 1e8 else 0.0
    assert np.load(out)[:, 0] == pytest.approx(begin + 0.01 * np.arange(50), abs=3e-7, rel=0)


def test_integrate_compares_methods(log, capsys, monkeypatch):
    monkeypatch.setattr(cli, "compare_on_log", partial(compare_on_log, methods=[]))
    assert main(["integrate", str(log[0]), "-m", "coning3", "-r", "100", "--compare"]) == 0
    text = capsys.readouterr().out
    assert text.index("400 attitudes by coning3") < text.index("comparing with the other methods")
    for method in ("previous", "coning2", "coning3"):
        assert f" {method} " in text
    assert "error of coning3 on 400 samples at 100 Hz, deg:" in text


def test_default_output_stands_beside_the_log(log):
    path = log[0]
    assert main(["integrate", str(path), "--q0", "0,2,0,0"]) == 0
    found = np.loadtxt(path.with_suffix(".attitudes.csv"), delimiter=",", skiprows=1)
    assert found[0].tolist() == [0.0, 0.0, 1.0, 0.0, 0.0]


SCENE_FILES = {
    ".toml": """
inertia = [2.0, 1.0, 1.5]
[[torque]]
model = "Damping"
coefficient = 0.1
[[torque]]
model = "HeavyTop"
arm = [0.0, 0.0, 0.1]
weight = 10.0
""",
    ".json": """{"inertia": [2.0, 1.0, 1.5], "torque": [{"model": "Damping", "coefficient": 0.1},
{"model": "HeavyTop", "arm": [0.0, 0.0, 0.1], "weight": 10.0}]}""",
}
ADVISE = ("recommend", "--t-end", "5", "--tol", "1e-8")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["integrate", "none.csv"], "No such file or directory: none.csv"),
        (["integrate", "{log}", "-c", "a,b,c"], "columns: found 'a'; accepted: 'Time (s)'"),
        (["integrate", "{log}", "-c", "1,2"], "accepted: 3 different columns"),
        (["integrate", "{log}", "-m", "rk4"], "--method: found 'rk4'; accepted: hold, trapezoid"),
        (["integrate", "{log}", "--q0", "0,0,0,0"], "--q0 is the zero quaternion"),
        (["integrate", "{log}", "--q0", "1,0,0"], "--q0: has shape (3,); accepted: (4,)\n"),
        (["integrate", "{log}", "-r", "-5"], "rate: found -5.0"),
        (["integrate", "{log}", "-o", "a.txt"], "--out: found the ending '.txt'"),
        (["integrate", "{log}", "-o", "{log}"], "log.csv, which is LOG; accepted: another file"),
        (["integrate", "{log}", "--max-gap", "1e-6"], "a gap"),
        (["integrate", "."], "directory"),
        (["trade", "--bodies", "0"], "--bodies: found 0"),
        (["trade", "--log", "none.csv"], "No such file"),
        (["trade", "--scene", "free", "--log", "none.csv"], "accepted: with --scene recordings"),
        (["trade", "--scene", "free", "--methods", "rk4,magnus4"], "--methods: found 'magnus4'"),
        (["trade", "--scene", "torqued", "--methods", "dmv4"], "accepted: rk4, cf4, rkmk4, rk8"),
        (["trade", "--inertia", "1,1,1"], "--t-end: is missing"),
        (["trade", "--t-end", "-5"], "--t-end: found without a scene of your own; accepted: with"),
        (["trade", "--w0", "{log}"], "--w0: found without a scene of your own"),
        (["trade", "--spin", "3"], "--spin: found without a scene of your own"),
        (["trade", "--inertia", "1,1,1", "--t-end", "1", "--scene", "free"], "--scene: found with"),
        ([*ADVISE], "no scene: accepted: --inertia, --rate or --scene-file"),
        ([*ADVISE, "--inertia", "1,2"], "--inertia: found 2 numbers; accepted: 3 or 9"),
        ([*ADVISE, "--inertia", "1,1,5"], "no body has one moment above the sum"),
        ([*ADVISE, "--rate", "Conning"], "rate: found 'Conning'; accepted: Coning, Constant"),
        ([*ADVISE, "--rate", "Coning"], "rate Coning: angle, frequency is missing"),
        ([*ADVISE, "--rate", "Coning", "angle"], "--rate: found 'angle'; accepted: name=number"),
        ([*ADVISE, "--rate", "Coning", "angle=x"], "--rate Coning angle: found 'x'"),
        ([*ADVISE, "--rate", "Coning", "tilt=1"], "rate Coning: found 'tilt'; accepted: angle"),
        (
            [*ADVISE, "--torque", "Damping", "coefficient=1"],
            "rate, inertia: found neither, with a torque",
        ),
        ([*ADVISE, "--scene-file", "none.toml"], "No such file"),
        ([*ADVISE, "--scene-file", "{log}"], "found the ending '.csv'; accepted: .json and .toml"),
        ([*ADVISE, "--inertia", "1,1,1", "--q0", "{log}"], "--q0: "),
        ([*ADVISE, "--inertia", "1,1,1", "--q0", "none.csv"], "none.csv not found"),
        ([*ADVISE, "--inertia", "1,1,1", "--w0", "a.txt"], "--w0: found the ending '.txt'"),
        ([*ADVISE, "--rate", "Coning", "angle=1", "frequency=1", "--bodies", "0"], "--bodies"),
    ],
)
def test_bad_input_ends_in_one_line(log, capsys, monkeypatch, tmp_path, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main([a.format(log=log[0]) for a in arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["nonsense"],
        ["integrate"],
        ["integrate", "a", "-u", "rps"],
        ["trade", "--scene", "moon"],
        ["methods", "--scene", "moon"],
        ["recommend", "--inertia", "1,1,1", "--t-end", "1"],
        ["recommend", "--inertia", "1,1,1", "--tol", "1"],
        ["recommend", "--inertia", "1,1,1", "--t-end", "1", "--tol", "1", "--budget", "1"],
    ],
)
def test_usage_errors(arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert "usage: fastatt" in capsys.readouterr().err


@pytest.mark.parametrize(
    "command",
    [[], ["integrate"], ["trade"], ["methods"], ["recommend"], ["precompile"], ["cache"]],
)
def test_help(command, capsys):
    with pytest.raises(SystemExit) as caught:
        main([*command, "--help"])
    assert caught.value.code == 0
    assert "usage: fastatt" in capsys.readouterr().out


def test_recommend(capsys, tmp_path):
    angles = np.random.default_rng(1).normal(size=(40, 4))
    np.savetxt(tmp_path / "q0.csv", angles, delimiter=",")
    scene = ["--rate", "Coning", "angle=0.5", "frequency=2", "--q0", str(tmp_path / "q0.csv")]
    assert main([*ADVISE, *scene, "--methods", "magnus4,rk4"]) == 0
    text = capsys.readouterr().out
    assert "(tol 1e-08)" in text
    assert "measured over 40 of 40 bodies" in text


def test_a_tolerance_out_of_reach_is_bad_input(capsys):
    scene = ["--rate", "Coning", "angle=0.5", "frequency=2", "--bodies", "20"]
    assert main(["recommend", "--t-end", "5", "--tol", "1e-17", *scene]) == 2
    assert "tol: found 1e-17; accepted: at least" in capsys.readouterr().err


def test_trade_of_an_own_scene(capsys, tmp_path):
    scene = ["--rate", "Coning", "angle=0.5", "frequency=2", "--t-end", "5", "--bodies", "40"]
    command = ["trade", *scene, "--methods", "magnus4,rk4", "--quick", "-o", str(tmp_path)]
    assert main(command) == 0
    names = {f"work_precision.{ending}" for ending in ("csv", "json", "png")}
    assert {p.name for p in tmp_path.iterdir()} == names
    assert "reference: the exact coning motion" in capsys.readouterr().out


@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_scene_files(tmp_path, suffix):
    path = tmp_path / f"scene{suffix}"
    path.write_text(SCENE_FILES[suffix], encoding="utf-8")
    scene = read_scene(path)
    assert scene.inertia == (2.0, 1.0, 1.5)
    damping, top = scene.torque.terms
    assert damping == fa.torques.Damping(0.1)
    assert top == fa.torques.HeavyTop(arm=(0.0, 0.0, 0.1), weight=10.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("inertia = [1", "scene.toml: "),
        ("mass = 1.0", "found 'mass'; accepted: inertia, rate"),
        ("rate = 1.0", 'rate: found 1.0; accepted: a table with a "model"'),
        ('torque = { model = "Custom" }', "torque: found 'Custom'"),
    ],
)
def test_bad_scene_files(tmp_path, text, message):
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        read_scene(path)


def test_a_warning_is_a_line(log, capsys):
    """Of a log that turns too far between its samples: no source of ours, and each once."""
    path, _, _ = log
    assert main(["integrate", str(path), "-m", "hold", "-r", "1"]) == 0
    found = capsys.readouterr()
    (line,) = found.err.splitlines()
    assert line.startswith("fastatt: warning: dt: interval ")
    assert "400 attitudes by hold" in found.out


def test_methods_lists_all(capsys):
    assert main(["methods"]) == 0
    text = capsys.readouterr().out
    for method in fa.METHODS.values():
        assert f"\n{method.name} " in f"\n{text}"
        assert method.summary in text


@pytest.mark.parametrize(
    ("scene", "own", "other"),
    [
        ("rate", "magnus4", "strang2"),
        ("free", "dmv2", "magnus4"),
        ("torqued", "strang2", "dmv2"),
        ("samples", "coning3_optimal", "rk4"),
    ],
)
def test_methods_of_a_scene(capsys, scene, own, other):
    assert main(["methods", "--scene", scene]) == 0
    text = f"\n{capsys.readouterr().out}"
    assert f"\n{own} " in text
    assert f"\n{other} " not in text


def test_methods_say_what_they_take(capsys):
    main(["methods"])
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()[::2]}
    bodies = "spherical, symmetric, free, torqued"
    assert f"order 4; rate, {bodies}: " in lines["rk4"]
    damped = f"order 2; {bodies} (torques free of w but for linear damping): "
    assert damped in lines["strang2"]
    assert f"closed form; {bodies}: " in lines["exact"]
    assert "order 1, 2 for increments; sampled rates, increments: " in lines["hold"]
    assert "order 4; increments: " in lines["coning3_optimal"]


@pytest.mark.parametrize("scene", [[], ["--inertia", "2,1,1.5", "--t-end", "1"]])
def test_where_results_cannot_go_nothing_is_measured(capsys, tmp_path, monkeypatch, scene):
    taken = tmp_path / "results"
    taken.write_text("")
    for name in ("fastatt.cli.work_precision", "fastatt.trade.recordings.log_rows"):
        monkeypatch.setattr(name, lambda *a, **k: pytest.fail("measured"))
    assert main(["trade", "-o", str(taken), *scene]) == 2
    assert capsys.readouterr().err == f"fastatt: File exists: {taken}\n"


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (OSError(28, "No space left on device"), "No space left on device"),
        (BrokenPipeError(32, "Broken pipe"), "standard output was closed before the end"),
    ],
)
def test_errors_without_a_file_are_a_line(capsys, monkeypatch, error, line):
    def failing():
        raise error

    monkeypatch.setattr("fastatt.cli.precompile.where", failing)
    assert main(["cache"]) == 2
    assert capsys.readouterr().err == f"fastatt: {line}\n"


def test_ctrl_c_in_a_command_is_a_line(capsys, monkeypatch):
    def interrupted():
        raise KeyboardInterrupt

    monkeypatch.setattr("fastatt.cli.precompile.where", interrupted)
    assert main(["cache"]) == 130
    assert capsys.readouterr().err == "fastatt: stopped\n"


def test_ctrl_c_while_modules_are_imported_is_a_line(capsys, monkeypatch):
    known = builtins.__import__

    def interrupted(name, *about, **more):
        if name == "fastatt.cli":
            raise KeyboardInterrupt
        return known(name, *about, **more)

    monkeypatch.setattr("builtins.__import__", interrupted)
    assert start() == 130
    assert capsys.readouterr().err == "fastatt: stopped\n"


def test_as_a_module():
    run = subprocess.run(
        [sys.executable, "-m", "fastatt", "integrate", "none.csv"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 2
    assert run.stderr == "fastatt: No such file or directory: none.csv\n"

"""The command line, run as a user runs it."""

import builtins
import subprocess
import sys

import numpy as np
import pytest
from each import each

import fastatt as fa
from fastatt.__main__ import main as start
from fastatt.cli import main


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
    arguments = ["-o", str(out), "-m", "coning2"]
    assert main(["integrate", str(path), *arguments]) == 0
    found = np.load(out) if suffix == ".npy" else np.loadtxt(out, delimiter=",", skiprows=1)
    expected = fa.integrate_rates(rates, np.diff(t), method="coning2")
    assert np.array_equal(found[:, 1:], expected)
    assert found[:, 0] == pytest.approx(t, abs=1e-15)
    text = capsys.readouterr().out
    assert "400 samples at 100 Hz (time stamps in Time (s))" in text
    assert "400 attitudes by coning2" in text


def test_units_that_the_log_does_not_say_are_asked_for(tmp_path, capsys):
    path = tmp_path / "log.csv"
    path.write_text("time,gyro_x,gyro_y,gyro_z\n0,1,2,3\n1,1,2,3\n2,1,2,3\n", encoding="utf-8")
    for options, missing in (
        (["--time-unit", "ms"], "gyro_x has no unit"),
        (["-u", "rad/s"], "time has no unit"),
    ):
        assert main(["integrate", str(path), *options]) == 2
        assert missing in capsys.readouterr().err
    assert main(["integrate", str(path), "-u", "rad/s", "--time-unit", "ms"]) == 0
    assert "3 samples at 1000 Hz" in capsys.readouterr().out


@pytest.mark.parametrize("start", [0.0, 12.5, 1.7e9])
def test_unix_stamps_are_kept(tmp_path, start):
    path, out = tmp_path / "log.csv", tmp_path / "out.npy"
    rows = "\n".join(f"{start + 0.01 * i:.2f},0.1,0.2,0.3" for i in range(50))
    path.write_text(f"time (s),gyro_x,gyro_y,gyro_z\n{rows}\n", encoding="utf-8")
    assert main(["integrate", str(path), "-u", "rad/s", "-o", str(out)]) == 0
    begin = start if start > 1e8 else 0.0
    assert np.load(out)[:, 0] == pytest.approx(begin + 0.01 * np.arange(50), abs=3e-7, rel=0)


def test_default_output_stands_beside_the_log(log):
    path = log[0]
    assert main(["integrate", str(path), "--q0", "0,2,0,0"]) == 0
    found = np.loadtxt(path.with_suffix(".attitudes.csv"), delimiter=",", skiprows=1)
    assert found[0].tolist() == [0.0, 0.0, 1.0, 0.0, 0.0]


def test_several_logs_and_other_sensors(log, tmp_path, capsys):
    path, t, rates = log
    bad, good, folder = tmp_path / "bad.csv", tmp_path / "good.csv", tmp_path / "out"
    bad.write_text("t (s),a,b\n0,1,2\n1,1,2\n", encoding="utf-8")
    head = "t (s),gyro_x (deg/s),gyro_y (deg/s),gyro_z (deg/s),u,v,w"
    table = np.column_stack([t, 1e5 * rates, rates])
    np.savetxt(good, table, delimiter=",", header=head, comments="")
    folder.mkdir()
    arguments = ["integrate", str(path), str(bad), str(good), "-o", str(folder), "-m", "hold"]
    assert main(arguments) == 2
    text = capsys.readouterr()
    named, warned, last = text.err.splitlines()
    assert "no three columns named like gyro" in named
    assert str(bad) in named
    assert last == "fastatt: 1 of 3 logs are not integrated"
    assert warned.startswith(f"fastatt: warning: {good}: dt: interval ")
    assert [p.name for p in sorted(folder.iterdir())] == [
        f"{p}.attitudes.csv" for p in ("good", "log")
    ]
    assert text.out.count("400 attitudes by hold") == 2

    sensors = ["--accel-columns", "u,v,w", "--accel-unit", "g", "--mag-columns", "7,6,5"]
    assert main(["integrate", str(good), "-o", str(tmp_path / "a.npy"), *sensors]) == 0
    rows = np.load(tmp_path / "a.npy")
    assert rows[:, 5:8] == pytest.approx(9.80665 * rates, rel=1e-15)
    assert np.array_equal(rows[:, 8:], table[:, [6, 5, 4]])
    # means have no sample at the first time
    arguments = ["integrate", str(good), "--values", "means", "--mag-columns", "5,6,7"]
    assert main(arguments) == 0
    names, first, second, *_ = good.with_suffix(".attitudes.csv").read_text().splitlines()
    assert names == "t,q0,q1,q2,q3,mx,my,mz"
    assert first == "0.0,1.0,0.0,0.0,0.0,nan,nan,nan"
    assert [float(x) for x in second.split(",")[5:]] == table[1, 4:].tolist()


@each(
    ("arguments", "message"),
    [
        (["integrate", "{log}", "{log}"], "log.attitudes.csv for several logs"),
        (["integrate", "{log}", "b", "-o", "c.npy"], "a file each, or an existing folder"),
        (["integrate", "none.csv"], "No such file or directory: none.csv"),
        (["integrate", "{log}", "-c", "a,b,c"], "--columns: found 'a'; accepted: 'Time (s)'"),
        (["integrate", "{log}", "-c", "1,2"], "accepted: 3 different columns"),
        (["integrate", "{log}", "-m", "rk4"], "--method: found 'rk4'; accepted: hold, trapezoid"),
        (["integrate", "{log}", "--q0", "0,0,0,0"], "--q0 is the zero quaternion"),
        (["integrate", "{log}", "--q0", "1,0,0"], "--q0: has shape (3,); accepted: (4,)\n"),
        (["integrate", "{log}", "-r", "-5"], "--rate: found -5.0"),
        (["integrate", "{log}", "-o", "a.txt"], "--out: found the ending '.txt'"),
        (["integrate", "{log}", "-o", "{log}"], "log.csv, which is LOG; accepted: another file"),
        (
            ["integrate", "{log}", "--max-gap", "1e-6"],
            'with --max-gap=; --on-bad-rows="drop" accepts',
        ),
        (["integrate", "."], "directory"),
        (["trade", "--bodies", "0"], "--bodies: found 0"),
        (["trade", "--scene", "free", "--methods", "rk4,magnus4"], "--methods: found 'magnus4'"),
        (["trade", "--scene", "torqued", "--methods", "dmv10"], "accepted: rk4, cf4, rkmk4, rk8"),
    ],
)
def test_bad_input_ends_in_one_line(log, capsys, monkeypatch, tmp_path, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main([a.format(log=log[0]) for a in arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@each("line", ["", "nonsense", "integrate", "integrate a -u rps", "trade --scene moon"])
def test_usage_errors(line, capsys):
    with pytest.raises(SystemExit) as caught:
        main(line.split())
    assert caught.value.code == 2
    assert "usage: fastatt" in capsys.readouterr().err


@each("command", ["", "integrate", "trade", "methods", "cache"])
def test_help(command, capsys):
    with pytest.raises(SystemExit) as caught:
        main([*command.split(), "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert "usage: fastatt" in text
    assert not command or f"example: fastatt {command}" in text


def test_a_warning_is_a_line(log, capsys):
    """Of a log that turns too far between its samples: no source of ours, and each once."""
    path, _, rates = log
    head = ",".join(f"gyro_{axis} [rad/s]" for axis in "xyz")
    np.savetxt(path, rates, delimiter=",", header=head, comments="")
    assert main(["integrate", str(path), "-m", "hold", "-r", "1"]) == 0
    found = capsys.readouterr()
    (line,) = found.err.splitlines()
    assert line.startswith("fastatt: warning: dt: interval ")
    assert "400 attitudes by hold" in found.out


def test_methods_are_listed_with_what_they_take(capsys):
    assert main(["methods"]) == 0
    text = capsys.readouterr().out
    for method in fa.METHODS.values():
        assert f"\n{method.name} " in f"\n{text}"
        assert method.summary in text
    head, *lines = text.split("\n\n")[0].splitlines()
    rows = {line.split()[0]: [cell.strip() for cell in line.split("  ") if cell] for line in lines}
    assert head.split() == ["method", "order", "scenes", "representations"]
    bodies = "spherical, symmetric, free, torqued"
    assert rows["rk4"][1:3] == ["4", f"rate, {bodies}"]
    assert rows["strang2"][1:3] == ["2", f"{bodies} *"]
    assert rows["exact"][1:3] == ["exact", bodies]
    assert rows["hold"][1:3] == ["1, 2 for increments", "sampled rates, increments"]
    # columns are aligned
    assert len({line.index("quat") for line in lines}) == 1


def test_where_results_cannot_go_nothing_is_measured(capsys, tmp_path, monkeypatch):
    taken = tmp_path / "results"
    taken.write_text("")
    monkeypatch.setattr("fastatt.trade.ensembles.study", lambda *a: pytest.fail("measured"))
    assert main(["trade", "-o", str(taken)]) == 2
    assert capsys.readouterr().err == f"fastatt: File exists: {taken}\n"


@each(
    ("error", "status", "line"),
    [
        (OSError(28, "No space left on device"), 2, "No space left on device"),
        (BrokenPipeError(32, "Broken pipe"), 2, "standard output was closed before the end"),
        (KeyboardInterrupt(), 130, "stopped"),
    ],
)
def test_errors_without_a_file_are_a_line(capsys, monkeypatch, error, status, line):
    def failing():
        raise error

    monkeypatch.setattr("fastatt.cli._store.where", failing)
    monkeypatch.setattr("sys.argv", ["fastatt", "cache"])
    assert start() == status
    assert capsys.readouterr().err == f"fastatt: {line}\n"


@pytest.mark.parametrize(
    "closed", [">&- 2>&-", *(pytest.param(x, marks=pytest.mark.slow) for x in (">&-", "2>&-"))]
)
def test_a_closed_output_is_no_error(closed):
    line = f"{sys.executable} -m fastatt cache {closed}"
    done = subprocess.run(["/bin/sh", "-c", line], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [(KeyboardInterrupt(), 130, "stopped"), (ImportError("no numba"), 2, "no numba")],
)
def test_what_ends_the_import_of_modules_is_a_line(capsys, monkeypatch, error, status, line):
    known = builtins.__import__

    def failing(name, *about, **more):
        if name == "fastatt.cli":
            raise error
        return known(name, *about, **more)

    monkeypatch.setattr("builtins.__import__", failing)
    assert start() == status
    assert capsys.readouterr().err == f"fastatt: {line}\n"


def test_as_a_module():
    command = [sys.executable, "-m", "fastatt", "integrate", "none.csv"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (2, "fastatt: No such file or directory: none.csv\n")

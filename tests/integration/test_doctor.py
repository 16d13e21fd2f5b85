"""`hallway doctor` on an emulated sensor and on none: text, JSON, exit codes."""

import json
import subprocess
import sys

import pytest

from drivers.transport import SerialStream
from drivers.urg04lx import faults
from drivers.urg04lx.emulator import Emulator
from drivers.urg04lx.model import URG_04LX_UG01, Mode
from drivers.urg04lx.pair import Session, attach
from runtime.cli import main


def doctor(capsys, *arguments):
    code = main(["doctor", "--seconds", "1.5", *arguments])
    return code, capsys.readouterr().out


def by_name(text):
    report = json.loads(text)
    return report, {finding["what"]: finding for finding in report["findings"]}


def test_a_working_sensor_works(capsys):
    with Emulator() as emulator:
        code, out = doctor(capsys, "--port", emulator.port, "--json")
        assert emulator.requests[-1] == b"TM2"
        assert emulator.sensor.mode is Mode.IDLE
    report, findings = by_name(out)
    assert code == 0
    assert report["works"] is True
    assert findings["sensor"]["found"] == "SOKUIKI Sensor URG-04LX, H0706400, 3.1.04(02/Aug./2007)"
    assert findings["beams"]["found"] == "682 from -119.5 to 119.9 deg"
    assert findings["clock offset"]["verdict"] == "ok"
    assert findings["zenoh"]["verdict"] in ("ok", "warn")
    assert {"cores", "CPU governor", "disk", "ModemManager", "held by", "permission"} <= findings.keys()
    assert all(set(f) == {"what", "found", "needed", "verdict", "advice"} for f in report["findings"])


def test_each_line_says_what_was_found_and_what_is_needed(capsys):
    with Emulator(model=URG_04LX_UG01) as emulator:
        code, out = doctor(capsys, "--port", emulator.port)
    assert code == 0
    lines = out.splitlines()
    assert lines[-1] == "it would work"
    assert any(line.startswith("ok    scan rate") and "(needed: 10 Hz)" in line for line in lines)
    assert any("UG01" in line for line in lines)


def test_without_a_sensor_the_code_is_three_and_the_machine_is_looked_at_all_the_same(capsys):
    code, out = doctor(capsys, "--port", "/dev/ttyNOWHERE", "--json")
    report, findings = by_name(out)
    assert code == 3
    assert report["works"] is False
    assert findings["port"]["verdict"] == "missing"
    assert "sensor" not in findings
    assert "disk" in findings


def test_a_silent_sensor_fails_with_advice(capsys, monkeypatch):
    monkeypatch.setattr("runtime.cli.checkup.sensor._CONNECT_S", 1.0)
    with Emulator() as emulator:
        emulator.silence()
        code, out = doctor(capsys, "--port", emulator.port, "--json")
    _, findings = by_name(out)
    assert code == 1
    assert findings["sensor"]["verdict"] == "fail"
    assert "plug" in findings["sensor"]["advice"]


def test_a_port_that_somebody_holds_is_not_opened_and_the_holder_named(capsys):
    with Emulator() as emulator:
        hold = "import sys; f = open(sys.argv[1]); print(flush=True); input()"
        with subprocess.Popen(
            [sys.executable, "-c", hold, emulator.port], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as other:
            assert other.stdout is not None
            other.stdout.readline()
            code, out = doctor(capsys, "--port", emulator.port, "--json")
            other.communicate(b"\n")
        assert not emulator.requests
    _, findings = by_name(out)
    assert code == 1
    assert str(other.pid) in findings["held by"]["found"]


def test_a_bad_cable_is_told_by_what_it_costs(capsys):
    with Emulator() as emulator:
        emulator.spoil(faults.delete(100), 100, every=4)
        code, out = doctor(capsys, "--port", emulator.port, "--json")
    _, findings = by_name(out)
    assert findings["bandwidth"]["verdict"] == "fail"
    assert "cable" in findings["bandwidth"]["advice"]
    assert code == 1


def test_a_line_too_slow_for_every_scan_fails_before_anything_is_opened(capsys):
    with Emulator(rs232=True) as emulator:
        code, out = doctor(capsys, "--port", emulator.port, "--baud", "115200", "--json")
        assert not emulator.requests
    _, findings = by_name(out)
    assert code == 1
    assert "185.5 ms" in findings["bandwidth"]["found"]
    assert "500000" in findings["bandwidth"]["advice"]


def test_the_udev_rule_is_printed(capsys):
    assert main(["doctor", "--udev"]) == 0
    assert "ID_MM_DEVICE_IGNORE" in capsys.readouterr().out


def test_after_the_doctor_the_sensor_is_free_and_measures():
    with Emulator() as emulator:
        main(["doctor", "--seconds", "0.5", "--port", emulator.port, "--json"])
        SerialStream(emulator.port, 115_200).close()
        with Session(attach(emulator), emulator) as session:
            assert session.more_scans(2)


@pytest.mark.parametrize("arguments", [["--baud", "x"], ["--nonsense"]])
def test_a_wrong_argument_is_a_usage_error(arguments, capsys):
    with pytest.raises(SystemExit) as wrong:
        main(["doctor", *arguments])
    assert wrong.value.code == 2
    assert arguments[-1] in capsys.readouterr().err

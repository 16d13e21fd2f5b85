"""Each check of the doctor on made-up machines and sensors: what it finds, how bad it is, what it advises."""

import os

import numpy as np
import pytest

from drivers.errors import PortBusyError
from drivers.ports import Holder, UsbPort
from drivers.urg04lx.connect import Identity
from drivers.urg04lx.events import Connected, Notice, UrgScan
from drivers.urg04lx.geometry import Sweep
from drivers.urg04lx.information import Parameters, Version
from drivers.urg04lx.protocol import StreamRequest
from drivers.urg04lx.settings import UrgConfig
from drivers.urg04lx.timecheck import Bounds, agreement
from runtime.cli.checkup import host, port, sensor
from runtime.cli.checkup.finding import Finding, Verdict, exit_code
from runtime.cli.checkup.sensor import Sample

URG = UsbPort("/dev/ttyACM3", "15d1", "0000", "1-4", "URG-Series USB Driver")


def finding(verdict):
    return Finding(what="x", found="y", needed="z", verdict=verdict)


@pytest.mark.parametrize(
    ("verdicts", "code"),
    [
        ([], 0),
        ([Verdict.OK, Verdict.WARN], 0),
        ([Verdict.OK, Verdict.FAIL], 1),
        ([Verdict.FAIL, Verdict.MISSING], 3),
    ],
)
def test_the_exit_code_says_whether_it_would_work(verdicts, code):
    assert exit_code([finding(verdict) for verdict in verdicts]) == code


def test_the_first_sensor_on_usb_is_found_and_a_second_one_is_told_of():
    path, found = port.find_port("auto", [URG])
    assert (path, found.verdict) == ("/dev/ttyACM3", Verdict.OK)
    other = UsbPort("/dev/ttyACM4", "15d1", "0000", "1-5", "")
    path, found = port.find_port("auto", [URG, other])
    assert (path, found.verdict) == ("/dev/ttyACM3", Verdict.WARN)
    assert "/dev/ttyACM4 (USB 1-5)" in found.found


def test_no_sensor_and_a_wrong_path_are_missing_and_the_right_path_is_named():
    path, found = port.find_port("auto", [])
    assert (path, found.verdict) == ("", Verdict.MISSING)
    assert "lsusb -d 15d1:" in found.advice
    path, found = port.find_port("/dev/ttyNOWHERE", [URG])
    assert (path, found.verdict) == ("", Verdict.MISSING)
    assert "/dev/ttyACM3" in found.advice


def test_a_link_is_shown_with_what_it_leads_to(tmp_path):
    (tmp_path / "tty").touch()
    (tmp_path / "laser").symlink_to(tmp_path / "tty")
    path, found = port.find_port(str(tmp_path / "laser"), [])
    assert path == str(tmp_path / "laser")
    assert found.found.endswith(f"-> {tmp_path / 'tty'}")


def test_a_forbidden_port_names_the_group_and_the_command(tmp_path, monkeypatch):
    path = tmp_path / "tty"
    path.touch()
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr("getpass.getuser", lambda: "ada")
    monkeypatch.setattr("grp.getgrgid", lambda _gid: type("Group", (), {"gr_name": "dialout"}))
    found = port.permission(str(path))
    assert found.verdict is Verdict.FAIL
    assert "sudo usermod -aG dialout ada" in found.advice


def test_an_allowed_port_is_fine(tmp_path):
    path = tmp_path / "tty"
    path.touch()
    assert port.permission(str(path)).verdict is Verdict.OK


def test_whoever_holds_the_port_is_named_with_the_way_to_end_it():
    found = port.holder("/dev/ttyACM0", [Holder(7, "python"), Holder(8, "ModemManager")])
    assert found.verdict is Verdict.FAIL
    assert "python (process 7)" in found.found
    assert "kill 7" in found.advice
    assert "systemctl stop ModemManager" in found.advice
    assert port.holder("/dev/ttyACM0", []).verdict is Verdict.OK


@pytest.mark.parametrize(
    ("running", "installed", "verdict"),
    [
        (True, False, Verdict.WARN),
        (True, True, Verdict.OK),
        (False, False, Verdict.OK),
        (False, True, Verdict.OK),
    ],
)
def test_modem_manager_is_harmless_if_the_rule_is_installed(tmp_path, running, installed, verdict):
    (tmp_path / "proc" / "12").mkdir(parents=True)
    (tmp_path / "proc" / "12" / "comm").write_text("ModemManager\n" if running else "bash\n")
    (tmp_path / "rules").mkdir()
    if installed:
        (tmp_path / "rules" / port.RULE).touch()
    found = port.modem_manager(tmp_path / "proc", (str(tmp_path / "rules"),))
    assert found.verdict is verdict
    assert ("sudo tee /etc/udev/rules.d/60-hallway-urg.rules" in found.advice) == (not installed)


def test_the_rule_gives_a_stable_name_and_keeps_modem_manager_away():
    lines = [line for line in port.rule_text().splitlines() if line and not line.startswith("#")]
    tty = next(line for line in lines if "SYMLINK" in line)
    assert 'ATTRS{idVendor}=="15d1", ATTRS{idProduct}=="0000"' in tty
    assert 'ENV{ID_MM_DEVICE_IGNORE}="1"' in tty
    assert "hallway-laser" in tty
    labels = {line.split('"')[1] for line in lines if line.startswith("LABEL=")}
    assert all(line.split('GOTO="')[1].rstrip('"') in labels for line in lines if "GOTO=" in line)


@pytest.mark.parametrize(
    ("governors", "pstate", "verdict"),
    [
        (["performance"], False, Verdict.OK),
        (["powersave"], False, Verdict.WARN),
        (["powersave"], True, Verdict.OK),
        ([], False, Verdict.OK),
    ],
)
def test_a_governor_that_saves_power_is_warned_of_unless_the_cpu_sees_to_it(
    tmp_path, governors, pstate, verdict
):
    for number, name in enumerate(governors):
        folder = tmp_path / f"cpu{number}" / "cpufreq"
        folder.mkdir(parents=True)
        (folder / "scaling_governor").write_text(name + "\n")
    if pstate:
        (tmp_path / "intel_pstate").mkdir()
    assert host.governor(tmp_path).verdict is verdict


@pytest.mark.parametrize(("free", "verdict"), [(5e9, Verdict.OK), (5e8, Verdict.WARN), (5e7, Verdict.FAIL)])
def test_the_disk_is_judged_where_the_results_will_be(tmp_path, monkeypatch, free, verdict):
    asked = []

    def usage(place):
        asked.append(place)
        return type("Usage", (), {"free": free})

    monkeypatch.setattr("shutil.disk_usage", usage)
    assert host.disk(tmp_path / "results" / "latest").verdict is verdict
    assert asked == [tmp_path]


@pytest.mark.parametrize(
    ("usable", "load", "verdict"), [(4, 0.5, Verdict.OK), (1, 0.1, Verdict.WARN), (2, 9.0, Verdict.WARN)]
)
def test_few_or_busy_cores_are_warned_of(monkeypatch, usable, load, verdict):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: set(range(usable)))
    monkeypatch.setattr(os, "getloadavg", lambda: (load, 0.0, 0.0))
    assert host.cores().verdict is verdict


def sample_of(count=50, *, noise_mm=2.0, valid=1.0, period_s=0.1, delay_ms=99.0, product="URG-04LX", **over):
    """What a watch of a healthy sensor brings; every figure can be made ill."""
    rng = np.random.default_rng(1)
    sweep = Sweep.of(StreamRequest(), Parameters())
    version = Version(product=product, firmware="3.1.04", serial="H0000001")
    connected = Connected(
        path="/dev/ttyACM0",
        baud=0,
        identity=Identity(version=version, parameters=Parameters()),
        request=StreamRequest(),
        sweep=sweep,
    )
    seen = rng.random(682) < valid
    scans = []
    for number in range(count):
        ranges = np.where(seen, 1.5 + noise_mm / 1000 * rng.standard_normal(682), np.nan).astype(np.float32)
        step_0_ns = round(number * period_s * 1e9) + 10**12
        scans.append(
            UrgScan(
                stamp_ns=step_0_ns + 4_296_875,
                arrival_ns=step_0_ns + round((delay_ms + rng.uniform(0, 2)) * 1e6),
                sensor_ms=round(number * period_s * 1e3) + 5000,
                ranges_m=ranges,
                valid=int(seen.sum()),
            )
        )
    # The true offset of the clocks: 10^12 ns are 5000 ms of the sensor.
    bounds = Bounds(10**6 - 5000 - 1.0, 10**6 - 5000 + 1.0, 12, 12)
    return Sample(**{"connected": connected, "scans": scans, "bounds": bounds, **over})


def judged(sample):
    return {finding.what: finding for finding in sensor.findings(sample, UrgConfig())}


def test_a_healthy_sensor_is_fine_in_every_respect():
    findings = judged(sample_of())
    assert list(findings) == [
        "sensor", "scan rate", "beams", "valid beams", "noise", "clock", "clock offset", "bandwidth",
    ]  # fmt: skip
    assert {finding.verdict for finding in findings.values()} == {Verdict.OK}
    assert findings["scan rate"].found == "10.00 Hz"
    assert findings["beams"].found == "682 from -119.5 to 119.9 deg"
    assert findings["noise"].found.startswith("2.0 mm")


@pytest.mark.parametrize(
    ("ill", "what", "verdict"),
    [
        ({"period_s": 0.2}, "scan rate", Verdict.FAIL),
        ({"valid": 0.1}, "valid beams", Verdict.WARN),
        ({"valid": 0.01}, "valid beams", Verdict.FAIL),
        ({"valid": 0.0}, "noise", Verdict.WARN),
        ({"noise_mm": 25.0}, "noise", Verdict.WARN),
        ({"noise_mm": 25.0, "product": "URG-04LX-UG01"}, "noise", Verdict.OK),
        ({"jumps": 1}, "clock", Verdict.WARN),
        ({"bounds": None}, "clock offset", Verdict.WARN),
        ({"delay_ms": 160.0}, "clock offset", Verdict.WARN),
        ({"damaged": 1}, "bandwidth", Verdict.WARN),
        ({"missed": 20}, "bandwidth", Verdict.FAIL),
    ],
)
def test_an_illness_is_seen_where_it_is(ill, what, verdict):
    found = judged(sample_of(**ill))[what]
    assert found.verdict is verdict
    assert bool(found.advice) == (verdict is not Verdict.OK)


def test_a_wrong_latency_is_advised_about_with_the_measured_one():
    found = judged(sample_of(delay_ms=160.0))["clock offset"]
    assert "set latency_ms: 160" in found.advice


def test_a_sensor_that_cannot_be_used_says_why_and_what_to_do():
    (found,) = sensor.findings(Sample(notices=[Notice("warn", "no answer; plug it in again")]), UrgConfig())
    assert (found.verdict, found.found, found.advice) == (Verdict.FAIL, "no answer", "plug it in again")
    (found,) = sensor.findings(Sample(error=PortBusyError("held by x")), UrgConfig())
    assert found.advice == "see above"
    (found,) = sensor.findings(Sample(), UrgConfig())
    assert "plug it in again" in found.advice


def test_bounds_of_the_clock_are_where_most_answers_agree():
    honest = [(100.0 - early, 101.0 + late) for early, late in ((0, 90), (50, 40), (90, 0), (20, 70))]
    assert agreement(honest, 4) == Bounds(100.0, 101.0, 4, 4)
    # The first answer was garbage: hours away.
    assert agreement([(402_000.0, 402_100.0), *honest], 5) == Bounds(100.0, 101.0, 4, 5)
    assert agreement([], 3) is None

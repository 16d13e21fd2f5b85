"""Ports found by USB identity in a copied sysfs, and the processes that hold them."""

import os
import subprocess
import sys

from drivers.ports import Holder, UsbPort, holders, usb_ports


def plug(sysfs, tty, location, vendor, product, name="URG-Series USB Driver"):
    device = sysfs / "devices" / "usb1" / location
    interface = device / f"{location}:1.0"
    (interface / "tty" / tty).mkdir(parents=True)
    (device / "idVendor").write_text(vendor + "\n")
    (device / "idProduct").write_text(product + "\n")
    (device / "product").write_text(name + "\n")
    (interface / "tty" / tty / "device").symlink_to(interface)
    (sysfs / "class" / "tty").mkdir(parents=True, exist_ok=True)
    (sysfs / "class" / "tty" / tty).symlink_to(interface / "tty" / tty)


def test_only_ports_of_the_wanted_identity_are_found_in_order_of_their_place_on_the_bus(tmp_path):
    plug(tmp_path, "ttyACM1", "1-1", "15d1", "0000")
    plug(tmp_path, "ttyACM0", "1-2", "15d1", "0000")
    plug(tmp_path, "ttyUSB0", "1-3", "0403", "6001")
    (tmp_path / "class" / "tty" / "ttyS0").mkdir()
    found = usb_ports("15D1", "0000", sysfs=tmp_path)
    assert [(port.path, port.location) for port in found] == [
        ("/dev/ttyACM1", "1-1"),
        ("/dev/ttyACM0", "1-2"),
    ]
    assert isinstance(found[0], UsbPort)
    assert found[0].name == "URG-Series USB Driver"


def test_a_machine_without_serial_ports_has_none(tmp_path):
    assert usb_ports("15d1", "0000", sysfs=tmp_path) == []


def test_a_process_that_has_the_file_open_is_a_holder_and_this_process_is_not(tmp_path):
    path = tmp_path / "port"
    path.touch()
    link = tmp_path / "by-name"
    link.symlink_to(path)
    with path.open() as ours:
        hold = "import sys; f = open(sys.argv[1]); print(); sys.stdin.read()"
        with subprocess.Popen(
            [sys.executable, "-c", hold, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as other:
            assert other.stdout is not None
            other.stdout.readline()
            found = holders(str(link))
            other.communicate()
        assert ours.fileno() > 0
    assert [holder.pid for holder in found] == [other.pid]
    assert os.getpid() not in [holder.pid for holder in found]


def test_a_holder_reads_as_a_name_and_a_number():
    assert str(Holder(4711, "ModemManager")) == "ModemManager (process 4711)"

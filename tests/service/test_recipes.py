"""The recipes of ``integrations/operate``.

systemd reads the units, their commands are Tandem's own, and the container's health check distinguishes a
running service from a stopped one.
"""

from __future__ import annotations

import configparser
import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import tyro

from planner.cli import service as commands
from tests.service.support import ROOT, Process

RECIPES = ROOT / "integrations" / "operate"
INSTALLED = "/opt/tandem/bin/tandem"
UNITS = ("tandem.service", "tandem-backup.service", "tandem-backup.timer")
COMMANDS = {"serve": commands.Serve, "token": commands.Token, "backup": commands.BackUp}
MAX_EXPOSURE = 2.0
"""Of ten, by `systemd-analyze security`; a unit that restricts nothing has 9.6."""


def parse_command(words: list[str]) -> object:
    """Parse a command with the command line. It exits for unknown arguments."""
    return tyro.cli(COMMANDS[words[0]], args=words[1:])


def unit(name: str) -> configparser.ConfigParser:
    read = configparser.ConfigParser(strict=False, interpolation=None)
    read.optionxform = str  # type: ignore[assignment,method-assign]
    read.read(RECIPES / name)
    return read


@pytest.fixture(scope="module")
def systemd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The units in a folder, where the command that they start is there."""
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    folder = tmp_path_factory.mktemp("units")
    there = folder / "tandem"
    there.write_text("#!/bin/sh\n")
    there.chmod(0o755)
    for name in UNITS:
        (folder / name).write_text((RECIPES / name).read_text().replace(INSTALLED, str(there)))
    return folder


def analyze(*words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["systemd-analyze", *map(str, words)], capture_output=True, text=True, check=False)


def test_systemd_reads_the_units(systemd: Path) -> None:
    read = analyze("verify", *(systemd / name for name in UNITS))
    ours = [line for line in read.stderr.splitlines() if str(systemd) in line or "tandem" in line]
    assert (read.returncode, ours) == (0, [])


def test_systemd_tells_a_unit_that_is_wrong(systemd: Path) -> None:
    """The previous check can fail."""
    wrong = systemd / "wrong.service"
    wrong.write_text((systemd / UNITS[0]).read_text().replace("OOMPolicy=continue", "OOMPolicy=go-on"))
    assert "go-on" in analyze("verify", wrong).stderr


def test_the_service_is_shut_in(systemd: Path) -> None:
    said = analyze("security", "--offline=true", "--no-pager", systemd / "tandem.service").stdout
    exposed = re.search(r"Overall exposure level for tandem\.service: ([0-9.]+)", said)
    assert exposed is not None, said
    assert float(exposed[1]) < MAX_EXPOSURE


def test_a_stop_reaches_the_service_alone_and_no_worker_takes_it_along() -> None:
    service = unit("tandem.service")["Service"]
    assert service["KillMode"] == "mixed"  # workers would end before the service knew why
    assert service["OOMPolicy"] == "continue"  # a worker's end is its job's
    assert service["WorkingDirectory"] == unit("tandem-backup.service")["Service"]["WorkingDirectory"]


def test_the_units_commands_are_ours() -> None:
    start = shlex.split(unit("tandem.service")["Service"]["ExecStart"])
    assert start[0] == INSTALLED and start[-2:] == ["$TANDEM_OPTIONS", "$TANDEM_SECRET_OPTIONS"]
    asked = parse_command(start[1:-2])
    assert isinstance(asked, commands.Serve)
    assert asked.require_token and asked.host == "127.0.0.1"  # behind a proxy that does TLS

    shell, flag, script = shlex.split(unit("tandem-backup.service")["Service"]["ExecStart"])
    assert (shell, flag) == ("/bin/sh", "-c")
    # systemd makes one of two; TANDEM_BACKUP_OPTIONS is split by the shell
    run = script.replace("$$", "$").replace("%%", "%").replace(INSTALLED, "printf '%s\\n'")
    environment = {"TANDEM_BACKUP_OPTIONS": "--database postgresql://h/d", "PATH": "/usr/bin:/bin"}
    words = subprocess.check_output([shell, flag, run], env=environment, text=True).splitlines()
    made = parse_command(words)
    assert isinstance(made, commands.BackUp)
    assert made.database == "postgresql://h/d"
    assert re.fullmatch(r"/var/lib/tandem-backups/\d{8}T\d{6}Z", str(made.folder))


def instructions() -> dict[str, list[str]]:
    """Of the container, the words behind each instruction that has them as JSON."""
    text = (RECIPES / "Containerfile").read_text().replace("\\\n", " ")
    result = re.findall(r"^(?:HEALTHCHECK .*)?(CMD|ENTRYPOINT) (\[.*\])$", text, re.M)
    health, entry, command = (json.loads(words) for _, words in result)
    return {"HEALTHCHECK": health, "ENTRYPOINT": entry, "CMD": command}


def test_the_container_serves_as_nobody_in_particular() -> None:
    result = instructions()
    assert result["ENTRYPOINT"] == ["tandem"]
    asked = parse_command(result["CMD"])
    assert isinstance(asked, commands.Serve) and asked.host == "0.0.0.0"
    text = (RECIPES / "Containerfile").read_text()
    assert re.search(r"^USER 10001:10001$", text, re.M)
    assert re.search(r"^STOPSIGNAL SIGTERM$", text, re.M)


def test_what_the_container_is_built_from_is_what_the_package_needs() -> None:
    kept = {
        line[1:] for line in (RECIPES / "Containerfile.containerignore").read_text().split() if line[0] == "!"
    }
    project = (ROOT / "pyproject.toml").read_text()
    packed = re.search(r"\[tool\.hatch\.build\.targets\.wheel\.force-include\]\n((?:.+\n)+)", project)
    assert packed is not None
    needed = {"planner", "pyproject.toml", "README.md", "LICENSE", *re.findall(r'^"(\w+)"', packed[1], re.M)}
    links = [path for path in (ROOT / "planner").rglob("*") if path.is_symlink()]
    needed |= {path.resolve().relative_to(ROOT).parts[0] for path in links}
    assert kept == needed


def test_the_health_check_tells_whether_the_service_is_there(tmp_path: Path) -> None:
    _, *words = instructions()["HEALTHCHECK"]
    process = Process(
        tmp_path / "data", module="tests.service.fake_team", arguments=(str(tmp_path / "data"), "")
    )
    process.wait()
    try:
        check = [sys.executable, *(word.replace(":8000", f":{process.port}") for word in words)]
        assert subprocess.run(check, capture_output=True, check=False).returncode == 0
    finally:
        process.stop()
    assert subprocess.run(check, capture_output=True, check=False).returncode == 1


def test_the_page_on_it_asks_for_commands_that_there_are() -> None:
    text = (RECIPES / "README.md").read_text().replace("\\\n", " ")
    found = re.findall(r"\btandem ((?:token add|backup) [^\s`-]\S*)", text)
    found += re.findall(r"\b(serve --host 0\.0\.0\.0[^`]*)`", text)
    found += [f"serve {line}" for line in re.findall(r'TANDEM_OPTIONS="([^"]*)"', text)]
    assert len(found) == 6, found
    for line in found:
        parse_command(line.split())

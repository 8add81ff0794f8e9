"""`workgauge cockpit`: what it refuses, and that it opens and ends."""

import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("starlette", reason="the cockpit's extra is not installed")

from workgauge.app.cockpit_processes import free_port
from workgauge.rehearse.shipped import shipped_path


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--scenario", "nowhere"), "nowhere"),
        (("--guard", "nothing"), "nothing"),
        (("--machine", "no.yaml"), "no.yaml"),
    ],
)
def test_what_cannot_be_used_is_refused(cli: Any, arguments: tuple[str, ...], words: str) -> None:
    answer = cli.workgauge("cockpit", "--no-open", *arguments)
    assert answer.code == 2
    assert words in answer.err


def test_a_port_that_is_taken_is_refused(cli: Any) -> None:
    port = free_port()
    with socket.create_server(("127.0.0.1", port)):
        answer = cli.workgauge("cockpit", "--no-open", "--port", port)
    assert answer.code == 2
    assert "something listens there already" in answer.err and str(port) in answer.err


def test_a_token_that_is_guessed_easily_is_refused(cli: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WORKGAUGE_TOKEN", "secret")
    answer = cli.workgauge("cockpit", "--no-open", "--host", "0.0.0.0")
    assert answer.code == 2
    assert "easy to guess" in answer.err and "secret" not in answer.err


def test_a_log_that_cannot_be_written_is_refused(cli: Any, tmp_path: Path) -> None:
    answer = cli.workgauge("cockpit", "--no-open", "--log", tmp_path)
    assert answer.code == 2
    assert "cannot be written" in answer.err and tmp_path.name in answer.err


def test_a_machine_with_a_mesh_that_is_none_is_refused(cli: Any, tmp_path: Path) -> None:
    description = yaml.safe_load(shipped_path("machines", "rre20.yaml").read_text())
    description["meshes"] = [{"link": "stick", "file": "stick.stl"}]
    (tmp_path / "stick.stl").write_bytes(b"not a mesh at all")
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(description))
    answer = cli.workgauge("cockpit", "--no-open", "--machine", tmp_path / "mine.yaml")
    assert answer.code == 2
    assert "mesh" in answer.err and "stick.stl" in answer.err.replace("\n", "")


@pytest.mark.prove
@pytest.mark.parametrize("remote", [False, True])
def test_it_opens_says_where_and_ends(remote: bool) -> None:
    port = free_port()
    begin = "from workgauge.app.cli import main; main()"
    asked = [sys.executable, "-c", begin, "cockpit", "--no-open", "--port", str(port)]
    if remote:
        asked += ["--host", "0.0.0.0", "--supervisor"]
    with subprocess.Popen(asked, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=os.environ) as done:
        assert done.stdout is not None
        said = ""
        while "Ctrl-C" not in said:
            line = done.stdout.readline()
            assert line, said
            said += line
        token = re.search(r"token=(\S+)", said)
        assert (token is not None) == remote
        if remote:
            assert "unencrypted" in said and said.count("?token=") == 2
        address = f"http://127.0.0.1:{port}/" + ("" if token is None else f"?token={token[1]}")
        opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
        assert b"workgauge cockpit" in opener.open(address).read()
        done.send_signal(signal.SIGINT)
        assert "ended" in done.stdout.read()
    assert done.returncode == 0

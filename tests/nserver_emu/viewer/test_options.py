"""--viewer on the command line: where, what is printed, what is missing."""

from __future__ import annotations

import argparse
import asyncio
import importlib.util
import re
from pathlib import Path

import pytest

from nclient.transports.listener import ListenAddress
from nserver_emu import cli
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.viewer.options import DEFAULT_PORT, add_options, refuse, running_viewer
from tests.nserver_emu.server.wire_client import simulation


def options(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_options(parser)
    return parser.parse_args(words)


@pytest.mark.parametrize(
    ("words", "place"),
    [
        ([], None),
        (["--viewer"], ListenAddress("127.0.0.1", DEFAULT_PORT)),
        (["--viewer", "0"], ListenAddress("127.0.0.1", 0)),
        (["--viewer", "0.0.0.0:8000"], ListenAddress("0.0.0.0", 8000)),
        (["--viewer", "[::1]:8000"], ListenAddress("::1", 8000)),
    ],
)
def test_where_the_page_is_served(words: list[str], place: ListenAddress | None) -> None:
    assert options(*words).viewer == place


@pytest.mark.parametrize("text", ["70000", "thesis_room", "1.2.3.4:"])
def test_what_is_no_port_is_wrong_usage(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        options("--viewer", text)
    assert "the world goes before --viewer" in capsys.readouterr().err


@pytest.mark.parametrize(("host", "name"), [("127.0.0.1", r"127\.0\.0\.1"), ("::1", r"\[::1\]")])
async def test_one_line_has_the_address_that_is_opened(
    host: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = Daemon(Emulator(simulation()))
    options = argparse.Namespace(
        viewer=ListenAddress(host, 0), viewer_token_file=None, model_file=None, students=[], method=[],
        localize=False, open_browser=True,
    )  # fmt: skip
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    async with running_viewer(daemon, options) as (line,), asyncio.timeout(10):
        while not opened:
            await asyncio.sleep(0.01)
    assert line.endswith(f" {opened[0]}")
    assert re.fullmatch(rf"listening viewer http://{name}:\d+/\?token=[\w-]{{32}}", line)


@pytest.mark.parametrize("option", ["--localize", "--open-browser"])
def test_options_that_need_a_page_imply_it(option: str) -> None:
    parser = argparse.ArgumentParser()
    add_options(parser)
    read = parser.parse_args([option])
    refuse(parser, read)
    assert read.viewer == ListenAddress(port=DEFAULT_PORT)


def test_own_filter_is_named_by_its_whole_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").touch()
    read = options("--viewer", "0", "--method", "mine.py:Mine", "--method", "package.module:Mine")
    assert read.method == [f"{tmp_path}/mine.py:Mine", "package.module:Mine"]


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (("--viewer", "0", "--method", "ekf"), "FILE.py:CLASS"),
        (("--viewer", "0", "--method", "nowhere.py:Mine"), "no such file"),
        (("--method", "package:Mine"), "give --viewer"),
    ],
)
def test_wrong_own_filter_is_refused(
    words: tuple[str, ...], error: str, capsys: pytest.CaptureFixture[str]
) -> None:
    parser = argparse.ArgumentParser()
    add_options(parser)
    with pytest.raises(SystemExit):
        refuse(parser, parser.parse_args(words))
    assert error in capsys.readouterr().err


async def test_without_the_option_there_is_no_page() -> None:
    async with running_viewer(Daemon(Emulator(simulation())), options()) as lines:
        assert lines == []


def test_without_aiohttp_the_extra_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    assert cli.main(["--port", "0", "--viewer", "0"]) == 2
    assert "[viewer]'" in capsys.readouterr().err

"""``coopqp play`` from the command line, with browsers that are no more than their connection."""

from __future__ import annotations

import os
import re
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import refused, typed
from forking import Program, program

from coopqp.execution.controller_run import run
from coopqp.scenario.loader import load

COMMAND = """
    import os, sys
    from coopqp.cli import main

    os.setsid()
    os.chdir(sys.argv[1])
    main(["play", *sys.argv[2:]])
"""
PATIENCE = 60.0  # [s], where the machine is busy


class Browser:
    """A connection as a browser makes it.

    Attributes:
        gizmo: where the first gizmo is, as this browser was told.
        words: all text that it was told.
    """

    def __init__(self, url: str) -> None:
        viser = pytest.importorskip("viser", reason="needs coopqp[viewer]")
        from websockets.sync.client import connect

        self._socket = connect(
            url.replace("http", "ws"),
            subprotocols=[f"viser-v{viser.__version__}"],
            max_size=None,
            ping_interval=None,
        )
        self.gizmo: tuple[float, ...] = ()
        self.words = ""
        self._say(_camera())

    def _say(self, message: Any) -> None:
        import msgspec

        self._socket.send(msgspec.msgpack.encode(message.as_serializable_dict()))

    def drag(self, *place: float) -> None:
        """Pull the first gizmo somewhere."""
        from viser import _messages as messages

        turn = (1.0, 0.0, 0.0, 0.0)
        self._say(messages.TransformControlsUpdateMessage("/gizmo/0", turn, place))  # type: ignore[arg-type]

    def until(self, done: Any) -> None:
        """Hear what it is told until something is so."""
        end = time.monotonic() + PATIENCE
        while not done():
            assert time.monotonic() < end, self.words[-2000:]
            for message in _decoded(self._socket.recv(PATIENCE)):
                if message["type"] == "SetPositionMessage" and message["name"] == "/gizmo/0":
                    self.gizmo = tuple(message["position"])
                if message["type"] == "GuiUpdateMessage":
                    self.words += str(message["updates"].get("content", ""))

    def crash(self) -> None:
        """Be gone without a word."""
        self._socket.socket.close()


def _camera() -> Any:
    from viser import _messages as messages

    return messages.ViewerCameraMessage(
        wxyz=(1.0, 0.0, 0.0, 0.0), position=(1.0, 0.0, 0.0), fov=1.0, near=0.01, far=100.0,
        image_height=800, image_width=1280, look_at=(0.0, 0.0, 0.0), up_direction=(0.0, 0.0, 1.0),
    )  # fmt: skip


def _decoded(data: bytes | str) -> list[dict[str, Any]]:
    import msgspec
    import zstandard

    assert isinstance(data, bytes)
    size = int.from_bytes(data[8:16], "little")
    plain = zstandard.ZstdDecompressor().decompress(data[16 : 16 + size])
    messages: list[dict[str, Any]] = msgspec.msgpack.decode(plain)["messages"]
    return messages


@pytest.fixture
def started(tmp_path: Path) -> Iterator[tuple[Program, str]]:
    """The command with one law, on any port that is free, and the page's address."""
    pytest.importorskip("viser", reason="needs coopqp[viewer]")
    words = ["point_on_point", "--controller", "qp", "--port", "0", "--record", "out"]
    with program(COMMAND, tmp_path, *words, "--speed", "4") as playing:
        ready = next(line for line in playing.out if not line.startswith("note:"))
        yield playing, ready.split()[0]


def test_two_browsers_one_goes_and_comes_back_and_the_end_is_one_line(
    started: tuple[Program, str], tmp_path: Path
) -> None:
    playing, url = started
    first, second = Browser(url), Browser(url)
    first.until(lambda: "On its way" in first.words)  # it plays as soon as somebody looks
    first.drag(0.15, 0.03, 0.04)
    second.until(lambda: second.gizmo == pytest.approx((0.15, 0.03, 0.04)))
    first.crash()
    second.drag(0.13, 0.05, 0.13)
    back = Browser(url)
    back.until(lambda: "LElbowRoll (lower" in back.words and "relax " in back.words)
    assert back.gizmo == pytest.approx((0.13, 0.05, 0.13))
    os.killpg(playing.pid, signal.SIGINT)  # as a terminal does: to all processes
    back.until(lambda: "coopqp play has ended" in back.words)
    assert re.fullmatch(r"ended after [\d.]+ s; wrote out/scenario.yaml\n", playing.out.read())
    assert playing.ended() == 0
    trace = run(load(tmp_path / "out" / "scenario.yaml"), controller="qp")
    sent = np.loadtxt(tmp_path / "out/inputs/reach.csv", delimiter=",", skiprows=1)[:, 2:]
    assert sent[-1].tolist() == pytest.approx([0.13, 0.05, 0.13])
    assert trace.ticks >= len(sent)


def _malformed(rng: np.random.Generator) -> Iterator[bytes | str | list[bytes]]:
    """What no page of ours sends: of nobody's format, types, lengths, sizes or keys."""
    import msgspec

    encode, gizmo = msgspec.msgpack.encode, {"type": "TransformControlsUpdateMessage"}
    turn, place = (1.0, 0.0, 0.0, 0.0), (0.1, 0.0, 0.1)
    wrong = (1.0,), (1.0, 2.0), (), (1e400, 0.0, 0.0), (float("nan"),) * 3, "abc", None, 5, {}
    for value in (*wrong, (1e308, 0.0, 0.0), ("1", "2", "3"), ((1.0,),) * 3, (0.0,) * 10_000):
        yield encode({**gizmo, "name": "/gizmo/0", "wxyz": turn, "position": value})
        yield encode({**gizmo, "name": "/gizmo/0", "wxyz": value, "position": place})
    for name in (5, None, "", "/gizmo/99", "/law0/object", [], "x" * 10_000):
        yield encode({**gizmo, "name": name, "wxyz": turn, "position": place})
    yield encode({**gizmo, "name": "/gizmo/0", "wxyz": turn, "position": place, "own": 1})
    for kind in ("ShareUrlRequest", "FileTransferStartUpload", "RunJavascriptMessage", "None", 7):
        yield encode({"type": kind})
    nested: list[Any] = []
    for _ in range(5000):
        nested = [nested]
    yield b"\x91" * 100_000 + b"\xc0"
    yield encode({"a": 1}), encode([1, 2]), encode("x" * 900_000)  # type: ignore[misc]
    for size in rng.integers(0, 3000, 40):
        yield rng.bytes(int(size))
    sound = encode({**gizmo, "name": "/gizmo/0", "wxyz": turn, "position": place})
    for _ in range(60):  # a byte of a message changed
        data = bytearray(sound)
        data[rng.integers(len(data))] = rng.integers(256)
        yield bytes(data)
    yield [rng.bytes(100) for _ in range(20)]  # in fragments
    yield "text, and not bytes"
    yield bytes(3 << 20)


def _connection(url: str, **headers: str) -> Any:
    from websockets.sync.client import connect

    viser = pytest.importorskip("viser", reason="needs coopqp[viewer]")
    protocol: Any = [f"viser-v{viser.__version__}"]
    return connect(
        url.replace("http", "ws"), subprotocols=protocol, max_size=None,
        additional_headers=headers, ping_interval=None, close_timeout=1,
    )  # fmt: skip


@pytest.mark.full
def test_malformed_messages_end_neither_the_page_nor_the_run(
    started: tuple[Program, str], rng: np.random.Generator
) -> None:
    import msgspec
    from websockets.exceptions import ConnectionClosed

    playing, url = started
    for batch in _malformed(rng):
        with _connection(url) as bad:
            camera = _camera()
            try:
                bad.send(msgspec.msgpack.encode(camera.as_serializable_dict()))
                for message in batch if isinstance(batch, tuple) else (batch,):
                    bad.send(message)
            except ConnectionClosed:  # which is an answer, too
                pass
    good, other = Browser(url), Browser(url)
    good.drag(0.15, 0.03, 0.04)
    other.until(lambda: other.gizmo == pytest.approx((0.15, 0.03, 0.04)))
    other.until(lambda: "playing at" in other.words)
    os.killpg(playing.pid, signal.SIGINT)
    assert re.fullmatch(r"ended after [\d.]+ s; wrote out/scenario.yaml\n", playing.out.read())
    assert playing.ended() == 0


def test_pages_of_other_sites_are_refused(started: tuple[Program, str]) -> None:
    import urllib.error
    import urllib.request

    from websockets.exceptions import InvalidStatus

    _, url = started
    for origin in ("http://evil.example", "http://127.0.0.1:1", "null", "file://"):
        with pytest.raises(InvalidStatus, match="403"):
            _connection(url, Origin=origin)
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(urllib.request.Request(url, headers={"Origin": origin}))
    with pytest.raises(urllib.error.HTTPError, match="403"):  # a name that was made to lead here
        urllib.request.urlopen(urllib.request.Request(url, headers={"Host": "evil.example"}))
    with pytest.raises((urllib.error.HTTPError, ConnectionError)):
        urllib.request.urlopen(url, data=b"x")
    assert urllib.request.urlopen(url).status == 200
    _connection(url, Origin=url).close()


def test_a_port_that_is_taken_is_one_line() -> None:
    pytest.importorskip("viser", reason="needs coopqp[viewer]")
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        result = typed("play", "point_on_point", "--port", port)
    assert result.exit_code == 2
    (line,) = result.stderr.splitlines()
    assert re.match(rf"error: cannot listen on 127.0.0.1:{port}: .*--port", line)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--port", "99999"], "--port: found 99999, needs 0 to 65535"),
        (["--host", "no such host"], "--host: found 'no such host': "),
        (["--host", "nonsense.invalid"], "needs an address of this machine: 127.0.0.1"),
        (["--host", "192.0.2.1"], "needs an address of this machine: 127.0.0.1"),
        (["--allow-origin", "lab.example"], "--allow-origin: found 'lab.example', needs scheme"),
        (["--allow-origin", "http://a/b"], "--allow-origin: found 'http://a/b', needs scheme"),
        (["--port", "0", "--record", "/proc/x"], "--record: cannot write to '/proc/x': No such"),
        (["--port", "0", "--record", __file__], "--record: cannot write to"),
        (["--port", "0", "--controller", "qpp"], "unknown controller 'qpp'; did you mean 'qp'"),
        (["--port", "0", "--controller", "torque_qp"], "torques, which this plant does not take"),
    ],
)
def test_what_cannot_be_played_is_one_line(words: list[str], said: str) -> None:
    pytest.importorskip("viser", reason="needs coopqp[viewer]")
    told = refused("play", "point_on_point", *words)
    assert said in told
    assert len([x for x in told.splitlines() if not x.startswith("note:")]) == 1


def test_a_speed_that_is_no_number_is_refused() -> None:
    said = refused("play", "point_on_point", "--port", "0", "--speed", "nan")
    assert "'--speed': nan is not in the range 0.05<=x<=4.0" in said


@pytest.mark.parametrize("there", ["scenario.yaml", "inputs/target.csv"])
def test_a_session_that_is_there_is_left_alone(there: str, tmp_path: Path) -> None:
    pytest.importorskip("viser", reason="needs coopqp[viewer]")
    (tmp_path / there).parent.mkdir(exist_ok=True)
    (tmp_path / there).write_text("mine")
    said = refused("play", "point_on_point", "--port", "0", "--record", str(tmp_path))
    words = "holds a session already; name another folder"
    assert said == f"error: --record: '{tmp_path}' {words}\n"
    assert (tmp_path / there).read_text() == "mine"


def test_looking_whether_a_recording_can_be_written_leaves_nothing(tmp_path: Path) -> None:
    from coopqp.viewer.steering import check_folder

    check_folder(tmp_path / "new" / "inside")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "empty").mkdir()
    check_folder(tmp_path / "empty")
    assert [path.name for path in tmp_path.rglob("*")] == ["empty"]


def test_without_viser_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    from coopqp.viewer import play

    monkeypatch.setattr(play.importlib.util, "find_spec", lambda name: None)
    said = refused("play", "point_on_point")
    assert said == "error: coopqp play needs: pip install 'coopqp[viewer]'\n"

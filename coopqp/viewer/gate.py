"""Who may talk to the page's process, and which messages it hears.

A page of another site, open in the same browser, can reach this machine's ports. So a browser's
requests count only from the page itself: their Origin is the Host that they ask for, and that is
an address, or a name of this machine (a foreign name can be made to lead here, by DNS rebinding).
Programs other than browsers send no Origin.

viser hears any message, sets what it names, and ends with an error at what it did not expect. Here
only those pass that a page of ours sends, with numbers that are finite and as many as needed.
"""

import dataclasses
import http
import ipaddress
import logging
import re
import socket
import warnings
from collections.abc import Sequence
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from coopqp.base.errors import InvalidValueError

MAX_BYTES = 1 << 20  # of a message from a browser
MAX_TEXT = 1000  # characters of a value
FARTHEST = 1e9  # no number of a page is larger
HEARD = frozenset({
    "ViewerCameraMessage", "GuiUpdateMessage", "SceneNodeClickMessage", "SceneNodeDragMessage",
    "TransformControlsUpdateMessage", "TransformControlsDragStartMessage",
    "TransformControlsDragEndMessage",
})  # fmt: skip
REFUSED = "refused: this page is for its own address; see coopqp play --allow-origin\n"


def checked_origins(origins: Sequence[str]) -> tuple[str, ...]:
    """As browsers say them; InvalidValueError: one is none."""
    found = tuple(given.rstrip("/").lower() for given in origins)
    for given, origin in zip(origins, found, strict=True):
        if not _is_host(_host_of(origin)):
            words = "needs scheme, host and port alone, such as https://lab.example:8443"
            raise InvalidValueError(f"--allow-origin: found '{given}', {words}")
    return found


def _is_host(host: str) -> bool:
    with suppress(ValueError):  # a port that is none
        url = urlsplit(f"//{host}")
        return url.port != 0 and bool(re.fullmatch(r"[\w.:-]+", url.hostname or ""))
    return False


def _host_of(origin: str) -> str:
    """``lab.example:8443`` of an origin; empty where it is none."""
    scheme, _, host = origin.lower().partition("://")
    return host if scheme in ("http", "https") and not set(host) & set("/?#@") else ""


def may_enter(
    hosts: Sequence[str], origins: Sequence[str], own: frozenset[str], allowed: Sequence[str]
) -> bool:
    """Whether a request with these headers Host and Origin may be answered.

    ``own`` are names of this machine, ``allowed`` origins beside the page's own.
    """
    if len(hosts) != 1 or len(origins) > 1:
        return False
    host = hosts[0].lower()
    if not (_is_here(host, own) or host in map(_host_of, allowed)):
        return False
    return not origins or origins[0].lower() in allowed or _host_of(origins[0]) == host


def _is_here(host: str, own: frozenset[str]) -> bool:
    with suppress(ValueError):
        name = urlsplit(f"//{host}").hostname or ""
        return name in own or bool(ipaddress.ip_address(name))
    return False


def own_names(host: str) -> frozenset[str]:
    """Names by which browsers may ask for this machine."""
    return frozenset(name.lower() for name in ("localhost", host, socket.gethostname()))


def guard(host: str, allowed: Sequence[str]) -> list[bool]:
    """Let viser's server, which is begun after this, hear only what is meant for it.

    Returns a list that is not empty once the server has asked; viser has no hook for this.
    """
    import websockets.asyncio.server as server
    from viser import _messages as messages

    for noisy in ("websockets", "asyncio"):  # of what others send nothing is to be printed
        logging.getLogger(noisy).setLevel(logging.CRITICAL + 1)
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
    own, guarded, serve = own_names(host), list[bool](), server.serve

    def guarded_serve(*args: Any, process_request: Any = None, **options: Any) -> Any:
        guarded.append(True)

        def enter(connection: Any, request: Any) -> Any:
            find = request.headers.get_all
            if may_enter(find("Host"), find("Origin"), own, allowed):
                return process_request(connection, request) if process_request else None
            return connection.respond(http.HTTPStatus.FORBIDDEN, REFUSED)

        return serve(*args, process_request=enter, **{**options, "max_size": MAX_BYTES})

    read, nothing = messages.Message.deserialize, messages.GuiUpdateMessage("", {})

    def hear(raw: bytes) -> Any:
        with suppress(Exception):
            found = read(raw)
            if type(found).__name__ in HEARD and is_sound(found):
                return found
        return nothing

    server.serve = guarded_serve  # type: ignore[assignment,misc]
    messages.Message.deserialize = staticmethod(hear)
    return guarded


def is_sound(message: Any) -> bool:
    """Whether a message has the types that its class declares, and no more than a page says."""
    import msgspec

    content = dataclasses.asdict(message)
    msgspec.convert(content, type(message))  # raises where it does not fit
    # Other updates would change what all browsers see.
    return set(content.get("updates", ())) <= {"value"} and _is_plain(content)


def _is_plain(x: Any) -> bool:
    if isinstance(x, dict | list | tuple):
        return all(map(_is_plain, x.values() if isinstance(x, dict) else x))
    if isinstance(x, int | float):
        return abs(x) < FARTHEST
    if not isinstance(x, str):
        return x is None
    with suppress(ValueError):  # of which viser would make a number
        return abs(float(x)) < FARTHEST
    return len(x) < MAX_TEXT

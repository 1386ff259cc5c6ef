"""`motionkit play`: live characters for browsers, programs and game engines."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from motionkit.cli.common import gathered, model_option, option, remark, say, visible
from motionkit.cli.outputs import FORMATS
from motionkit.cli.rig_options import RigChoice, rig_options
from motionkit.cli.showing import open_in_browser
from motionkit.cli.synthesis_options import reference_option

if TYPE_CHECKING:
    from motionkit.play.server import Addresses


def _target(context: click.Context, parameter: click.Parameter, value: str | None) -> tuple[str, int] | None:
    if value is None:
        return None
    host, _, port = value.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise click.BadParameter(f"expected HOST:PORT such as 127.0.0.1:39539, found {value!r}")
    return host.strip("[]"), int(port)


class _VisibleLines(logging.Formatter):
    """Escapes control characters, because text from clients, even in a traceback, must not control the terminal."""

    def format(self, record: logging.LogRecord) -> str:
        return "\n".join(visible(line) for line in super().format(record).splitlines())


@contextmanager
def _visible_log() -> Iterator[None]:
    handler = logging.StreamHandler()
    handler.setFormatter(_VisibleLines())
    logging.getLogger().addHandler(handler)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(handler)


@dataclass(frozen=True)
class Listening:
    """Addresses of the server and its outputs, the format of recordings, and what is printed."""

    host: str
    port: int
    tcp: int | None
    vmc: tuple[str, int] | None
    recording_format: str | None
    headless: bool
    no_open: bool
    as_json: bool

    def ready(self, addresses: Addresses) -> None:
        """Print the addresses and open the page."""
        if self.as_json:
            click.echo(json.dumps(asdict(addresses)))
        else:
            say(addresses.socket if self.headless else addresses.url)
            if addresses.tcp:
                remark(f"newline JSON on {addresses.tcp[0]}:{addresses.tcp[1]}")
            if addresses.vmc:
                remark(f"VMC to {addresses.vmc[0]}:{addresses.vmc[1]}")
            if addresses.token:
                remark("anyone with this address and token can steer; TCP clients send the token first")
            remark("Ctrl-C stops the server")
        if not self.headless and not self.no_open:
            open_in_browser(addresses.url)


@click.command("play")
@model_option
@reference_option
@click.option(
    "--character", help="Body of new characters; that of the --rig by default, else the model's default."
)
@option(
    "--port",
    default=8642,
    type=click.IntRange(0, 65535),
    help="Web page port; 0 picks a free one.",
)
@option(
    "--host",
    default="127.0.0.1",
    help="Address to listen on. With an address that other machines reach, they can connect; they need the "
    "printed token.",
)
@click.option("--no-open", is_flag=True, help="Do not open the browser.")
@click.option("--headless", is_flag=True, help="Serve programs only, without the web page.")
@click.option(
    "--tcp",
    type=click.IntRange(0, 65535),
    help="Also serve newline-delimited JSON on this TCP port; 0 picks a free one.",
)
@click.option(
    "--vmc", metavar="HOST:PORT", callback=_target, help="Also send one character as VMC (OSC over UDP)."
)
@rig_options
@click.option(
    "--format",
    "recording_format",
    type=click.Choice([form for form in FORMATS if form != "fbx"]),  # as in play.recording
    help="Format of recordings; programs may ask for another one. By default that of the character of --rig, else bvh.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the addresses as one line of JSON.")
@gathered("listening", Listening)
def command(
    model_path: Path | None,
    reference: str,
    character: str | None,
    choice: RigChoice,
    listening: Listening,
) -> None:
    """Start a server on this machine and open its page, to steer characters live.

    Keys or a gamepad move the character; programs connect by WebSocket, TCP or VMC (docs/live.md). With --rig,
    characters have the body of that file, and recordings and TCP frames are on its joints. Ctrl-C stops the server.
    """
    from motionkit.play.recording import holds

    if not holds(listening.recording_format, choice.rig):
        raise click.UsageError("--format vrm takes an avatar: give one with --rig avatar.vrm")
    try:
        import websockets  # noqa: F401
    except ImportError:
        from motionkit.errors import MotionkitError

        raise MotionkitError("play needs the package websockets: pip install 'motionkit[play]'") from None
    import asyncio

    from motionkit.cli.main import print_stopped
    from motionkit.models.bundled import open_model
    from motionkit.play.on_rig import with_rig, with_soles
    from motionkit.play.requests import MAX_NAME
    from motionkit.play.server import PlayServer, ServerOptions
    from motionkit.play.session import Session

    model = with_soles(open_model(model_path, reference))
    if choice.rig is not None:
        if len(choice.rig.name) > MAX_NAME:
            raise click.UsageError(f"--rig: expected a file name of at most {MAX_NAME} characters; rename it")
        model = with_rig(model, choice.rig)
        character = character or choice.rig.name
    session = Session(model, character or "default")
    options = ServerOptions(
        listening.host,
        listening.port,
        listening.tcp,
        listening.vmc,
        not listening.headless,
        choice.rig,
        choice.clip,
        listening.recording_format or choice.ending[1:],
    )
    with _visible_log():
        try:
            asyncio.run(PlayServer(session, options).run(listening.ready))
        except KeyboardInterrupt:
            pass  # systems without signal handlers in the event loop
    print_stopped()

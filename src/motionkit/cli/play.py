"""`motionkit play`: live characters for the browser, programs and game engines."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from motionkit.cli.common import model_option, remark, say, visible
from motionkit.cli.motion_options import FORMATS
from motionkit.cli.rig_options import RigChoice, rig_options
from motionkit.cli.synthesis_options import reference_option


def _target(context: click.Context, parameter: click.Parameter, value: str | None) -> tuple[str, int] | None:
    if value is None:
        return None
    host, _, port = value.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise click.BadParameter(f"expected HOST:PORT such as 127.0.0.1:39539, found {value!r}")
    return host.strip("[]"), int(port)


class _VisibleLines(logging.Formatter):
    """Escapes control characters: text from clients, even in a traceback, must not control the terminal."""

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


@click.command("play")
@model_option
@reference_option
@click.option(
    "--character", help="Body of new characters; that of the --rig by default, else the model's default."
)
@click.option(
    "--port",
    default=8642,
    show_default=True,
    type=click.IntRange(0, 65535),
    help="Web page port; 0 picks a free one.",
)
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
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
    type=click.Choice(FORMATS),
    default="bvh",
    show_default=True,
    help="Format of recordings; programs may ask for another one.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the addresses as one line of JSON.")
def command(
    model_path: Path | None,
    reference: str,
    character: str | None,
    port: int,
    host: str,
    no_open: bool,
    headless: bool,
    tcp: int | None,
    vmc: tuple[str, int] | None,
    choice: RigChoice,
    recording_format: str,
    as_json: bool,
) -> None:
    """Start a server on this machine and open its page, to steer characters live.

    Keys or a gamepad move the character; programs connect by WebSocket, TCP or VMC (docs/live.md). With --rig,
    characters have the body of that file, and recordings and TCP frames are on its joints. Ctrl-C stops the server.
    """
    try:
        import websockets  # noqa: F401
    except ImportError:
        from motionkit.errors import MotionkitError

        raise MotionkitError("play needs the package websockets: pip install 'motionkit[play]'") from None
    import asyncio

    from motionkit.cli.main import tell_stopped
    from motionkit.cli.showing import open_in_browser
    from motionkit.models.bundled import open_model
    from motionkit.play.server import Addresses, PlayServer, ServerOptions
    from motionkit.play.session import Session

    def ready(addresses: Addresses) -> None:
        if as_json:
            places = {
                "url": addresses.url,
                "socket": addresses.socket,
                "tcp": addresses.tcp,
                "vmc": addresses.vmc,
                "token": addresses.token,
            }
            click.echo(json.dumps(places))
        else:
            say(addresses.socket if headless else addresses.url)
            if addresses.tcp:
                remark(f"newline JSON on {addresses.tcp[0]}:{addresses.tcp[1]}")
            if addresses.vmc:
                remark(f"VMC to {addresses.vmc[0]}:{addresses.vmc[1]}")
            if addresses.token:
                remark("anyone with this address and token can steer; TCP clients send the token first")
            remark("Ctrl-C stops the server")
        if not headless and not no_open:
            open_in_browser(addresses.url)

    model = open_model(model_path, reference)
    if choice.rig is not None:
        from motionkit.play.on_rig import with_rig

        model = with_rig(model, choice.rig)
        character = character or choice.rig.name
    session = Session(model, character or "default")
    options = ServerOptions(host, port, tcp, vmc, not headless, choice.rig, choice.clip, recording_format)
    with _visible_log():
        try:
            asyncio.run(PlayServer(session, options).run(ready))
        except KeyboardInterrupt:
            pass  # on systems without signal handlers for the event loop
    tell_stopped()

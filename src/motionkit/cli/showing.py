"""Opens pages in the browser, if there is one."""

from __future__ import annotations

import os
import sys
import webbrowser


def open_in_browser(address: str) -> bool:
    """Open an address in the user's browser; False without a desktop, in CI, or without a browser."""
    if not has_desktop():
        return False
    try:
        return webbrowser.open(address)
    except webbrowser.Error:
        return False


def has_desktop() -> bool:
    """Whether a window can open: False over plain SSH and in CI."""
    if os.environ.get("CI"):
        return False
    if sys.platform in ("win32", "darwin"):
        return not os.environ.get("SSH_CONNECTION")
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))

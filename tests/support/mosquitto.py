"""A broker of messages on this machine, as the documentation says that it is to be set up."""

from __future__ import annotations

import getpass
import os
import shutil
import socket
import subprocess
import time
from pathlib import Path

from places import ROOT

PATHS = f"{os.environ['PATH']}:/usr/sbin"


def mosquitto_is_installed() -> bool:
    return shutil.which("mosquitto", path=PATHS) is not None


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def documented() -> str:
    """The settings of mosquitto in the documentation."""
    text = (ROOT / "docs/fleet.md").read_text(encoding="utf-8")
    return text[text.index("persistence true") :].partition("```")[0]


class Broker:
    """A mosquitto as the documentation has it, which asks for a password."""

    def __init__(self, folder: Path) -> None:
        self.port, self.folder, self.process = free_port(), folder, None
        folder.mkdir()
        (folder / "users").touch(0o600)
        subprocess.run(
            [shutil.which("mosquitto_passwd"), "-b", folder / "users", "ann", "secret"],
            check=True,
        )
        (folder / "mosquitto.conf").write_text(
            f"listener {self.port} 127.0.0.1\npassword_file {folder}/users\n"
            f"persistence_location {folder}/\nuser {getpass.getuser()}\n{documented()}"
        )

    def start(self) -> None:
        program = shutil.which("mosquitto", path=PATHS)
        self.process = subprocess.Popen(
            [program, "-c", self.folder / "mosquitto.conf"], stderr=subprocess.DEVNULL
        )
        for _ in range(100):
            try:
                socket.create_connection(("127.0.0.1", self.port), 1.0).close()
                return
            except OSError:
                time.sleep(0.05)

    def stop(self, *, kill: bool = False) -> None:
        if self.process is not None:
            (self.process.kill if kill else self.process.terminate)()
            self.process.wait()
            self.process = None

"""The page's process as the node's child: it ends with the node, however that ends, and its failure costs nothing."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile

from biodyn_ros.dashboard.settings import TOKEN_VARIABLE, ServingSettings, address_of, page_token, port_of

ENDS_WITHIN_S = 2.0
"""Behind the node's own end, which is bounded too."""


class PageChild:
    """Serves the page of a node by its full name until `end`, in the node's domain."""

    def __init__(self, node: str, domain_id: int, serving: ServingSettings) -> None:
        # Chosen here: the child's own choice would be known to nobody who reads what the node says.
        token, port = page_token(), port_of(serving)
        self.link = address_of(serving.page_host, port, token)
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - as long as the child lives
        # Standard input ends when this process does, even by kill -9: then the page ends too.
        self._process = subprocess.Popen(
            [
                sys.executable, "-m", "biodyn_ros.commands.cli", "page", "--node", node, "--until-input-ends",
                "--page-host", serving.page_host, "--page-port", str(port),
            ],
            stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=self._said,
            env=os.environ | {"ROS_DOMAIN_ID": str(domain_id), TOKEN_VARIABLE: token},
        )  # fmt: skip

    @property
    def address(self) -> str:
        """Where it is served, without the token."""
        return self.link.partition("#")[0]

    @property
    def failure(self) -> str:
        """Why it is not served any more; empty while it is."""
        if self._process.poll() is None:
            return ""
        self._said.seek(0)
        lines = self._said.read().decode("utf-8", "replace").strip().splitlines()
        return lines[-1] if lines else f"its process ended with {self._process.returncode}"

    def ask(self) -> None:
        """Ask it to end."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()

    def end(self) -> None:
        """End it, and wait for that."""
        self.ask()
        try:
            self._process.wait(ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._said.close()

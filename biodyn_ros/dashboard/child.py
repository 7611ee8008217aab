"""The page server as a child process of the node: it ends with the node, and its failure does not affect the node."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile

from biodyn_ros.dashboard.settings import TOKEN_VARIABLE, ServingSettings, address_of, page_token, port_of

ENDS_WITHIN_S = 2.0
"""Time to end after its input is closed; the shutdown of the node is bounded too."""


class PageChild:
    """Serves the page of a node, by its full name, in the node's domain until `end`."""

    def __init__(self, node: str, domain_id: int, serving: ServingSettings) -> None:
        # Chosen here, because the node prints the link.
        token, port = page_token(), port_of(serving)
        self.link = address_of(serving.page_host, port, token)
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - open while the child runs
        # Standard input ends with this process, even after kill -9; the page then ends too.
        self._process = subprocess.Popen(
            [
                sys.executable, "-m", "biodyn_ros.commands.cli", "page", "--node", node, "--until-input-ends",
                "--page-host", serving.page_host, "--page-port", str(port),
            ],
            stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=self._errors,
            env=os.environ | {"ROS_DOMAIN_ID": str(domain_id), TOKEN_VARIABLE: token},
        )  # fmt: skip

    @property
    def address(self) -> str:
        """The address of the page, without the token."""
        return self.link.partition("#")[0]

    @property
    def failure(self) -> str:
        """The reason why the page is not served; empty while it is."""
        if self._process.poll() is None:
            return ""
        self._errors.seek(0)
        lines = self._errors.read().decode("utf-8", "replace").strip().splitlines()
        return lines[-1] if lines else f"its process ended with {self._process.returncode}"

    def request_end(self) -> None:
        """Request the end of the process."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()

    def end(self) -> None:
        """End the process and wait for its exit."""
        self.request_end()
        try:
            self._process.wait(ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._errors.close()

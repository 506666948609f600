"""A viewer that records published messages, without a daemon."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any


@contextmanager
def page_that(answers: Callable[[Any], tuple[int, str]]) -> Iterator[tuple[str, list[tuple[str, Any]]]]:
    """Serve a viewer that answers each message with `answers(message)`; yield its URL and (path, message) pairs."""
    received: list[tuple[str, Any]] = []

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_POST(self) -> None:  # http.server names it
            message = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            received.append((self.path, message))
            status, body = answers(message)
            self.send_response(status)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body.encode())

        def log_message(self, *_: object) -> None: ...

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        # A short poll interval, as shutdown() waits for the next poll.
        serving = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        serving.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/?token=secret", received
        finally:
            server.shutdown()
            serving.join()

"""The page of the viewer with its modules and a scene inside.

Browsers load no module from `file:`, so the modules are there as text, packed, and the script
`standalone.js` of the page makes addresses of them. The page may use nothing else: its policy
allows no request.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import html
from collections.abc import Mapping

__all__ = ["one_page"]

STYLE = '<link rel="stylesheet" href="viewer.css" />'
START = '<script type="module" src="viewer.js"></script>'
LOADER = "standalone.js"
POLICY = (
    "default-src 'none'; script-src 'sha256-{loader}' blob: 'wasm-unsafe-eval'; worker-src blob:;"
    " connect-src data: blob:; img-src data: blob:; style-src 'unsafe-inline'"
)


def one_page(page: Mapping[str, bytes], name: str, stream: bytes, up: str | None = None) -> bytes:
    """A page that shows a stream without a server.

    Args:
        page: the files of the built page.
        name: of the stream, which the page shows.
        stream: its bytes.
        up: axis that is up where the stream says nothing of it.
    """
    texts = {file: data.decode() for file, data in page.items()}
    loader = texts[LOADER]
    label = html.escape(name.encode(errors="replace").decode())
    axis = "" if up is None else f' data-up="{up}"'
    parts = [
        f'<template id="licences"><pre>{html.escape(texts["LICENSES.txt"])}</pre></template>',
        *(
            f'<script type="text/plain" data-module="{file}">'
            f"{_base64(gzip.compress(page[file], mtime=0))}</script>"
            for file in _modules(texts)
        ),
        f'<script type="text/plain" data-scene="{label}"{axis}>{_base64(stream)}</script>',
        f'<script type="module">{loader}</script>',
    ]
    loader_hash = _base64(hashlib.sha256(loader.encode()).digest())
    policy = POLICY.format(loader=loader_hash)
    changes = {
        "<head>": f'<head>\n    <meta http-equiv="Content-Security-Policy" content="{policy}" />',
        STYLE: f"<style>\n{texts['viewer.css']}</style>",
        START: "",
        "</body>": "\n".join([*parts, "</body>"]),
    }
    text = texts["index.html"]
    for old, new in changes.items():
        before, found, after = text.partition(old)
        if not found:
            raise ValueError(f"index.html has no {old}")
        text = before + new + after
    return text.encode()


def _modules(texts: Mapping[str, str]) -> list[str]:
    """The modules of the page, each behind those that it names."""
    names = [file for file in texts if file.endswith(".js") and file != LOADER]
    needs = {
        file: {
            other for other in names if f'/{other}"' in texts[file] or f'"{other}"' in texts[file]
        }
        for file in names
    }
    order: list[str] = []
    while len(order) < len(names):
        ready = sorted(file for file in names if file not in order and needs[file] <= {*order})
        if not ready:
            raise ValueError("modules of the page name each other")
        order += ready
    return order


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()

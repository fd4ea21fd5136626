"""What is up in a stream that does not say it, so that pages open it upright."""

from __future__ import annotations

from importlib.util import find_spec

from evogs_codec.decoding.decode import decode_leaves
from evogs_codec.errors import StreamError
from evogs_codec.format.directory import read_directory
from evogs_codec.model.viewpoint import default_viewpoint

__all__ = ["shown_axis"]

PLAIN = "z"  # what pages take for up


def shown_axis(data: bytes) -> str | None:
    """The axis that the splats of a stream show to be up, for instance `-y`.

    Returns:
        None if it is z, as pages take it to be; if the stream says it, by its header or its default
        camera; if its splats show none, or nothing can be rendered; and for a stream with a fault,
        of which the page tells.
    """
    if find_spec("numba") is None:
        return None
    from evogs_codec.render.up import AXES, said_by, shown_by

    try:
        directory = read_directory(data)
        if said_by(directory.info) or default_viewpoint(directory.info.text) is not None:
            return None
        found = shown_by(decode_leaves(data, directory=directory))
    except StreamError:
        return None
    is_other = found is not None and found.name in AXES and found.name != PLAIN
    return found.name if found is not None and is_other else None

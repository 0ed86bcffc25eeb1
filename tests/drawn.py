"""What a picture holds."""

from __future__ import annotations


def artists(ax) -> dict[str, list]:
    """The artists of axes by their group, as drawings name it."""
    found: dict[str, list] = {}
    for artist in ax.get_children():
        if artist.get_gid():
            found.setdefault(artist.get_gid(), []).append(artist)
    return found

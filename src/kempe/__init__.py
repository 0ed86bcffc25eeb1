"""Kempe: every position question about a multibody system, open chain, tree or closed loop, in the plane or in space."""

from __future__ import annotations

from kempe import spatial
from kempe.description.mechanism import Mechanism
from kempe.model.system import System

__version__ = "0.1.0"

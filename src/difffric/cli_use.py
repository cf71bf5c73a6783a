"""The commands that use the friction: plan a push, centre a ring, watch a machine, export."""

from __future__ import annotations

from difffric.cli_parts import app as app

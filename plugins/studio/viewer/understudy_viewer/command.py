"""``understudy motion view``: clips and runs in the browser."""

from __future__ import annotations

import argparse
import importlib.util

from understudy.command.command import Command
from understudy.errors import ConfigError
from understudy.setup.plugins import installed
from understudy_motion.arguments import add_reading, open_clip, port
from understudy_motion.clip import Clip
from understudy_skills.folder import run_folder
from understudy_viewer.serving import serve
from understudy_viewer.sources import open_scene
from understudy_viewer.stage import build


class View(Command):
    """Serves the motion page until interrupted."""

    example = "understudy motion view cycle.npz"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "source",
            metavar="SOURCE",
            help="a clip file, the name of a clip, or a run folder or skill, which shows the learned "
            "motion beside its reference",
        )
        parser.add_argument(
            "other", metavar="OTHER", nargs="?", help="another source, shown beside the first"
        )
        parser.add_argument(
            "--character",
            metavar="NAME",
            help="the figure that is shown: a character, an MJCF file, or that of a run folder; by default the run's, or the "
            "one that fits the clip",
        )
        parser.add_argument(
            "--host",
            default="127.0.0.1",
            help="address to serve at (%(default)s: this machine only)",
        )
        parser.add_argument(
            "--port", type=port, default=8080, help="port, or the first to try (%(default)s)"
        )
        parser.add_argument(
            "--no-browser", action="store_true", help="serve the page without opening it"
        )
        add_reading(parser)

    def run(self, options: argparse.Namespace) -> int:
        if importlib.util.find_spec("viser") is None:
            raise ConfigError("The motion page needs viser: pip install 'understudy[view]'")
        from understudy_viewer.page import Page, free_port

        named = [source for source in (options.source, options.other) if source is not None]
        sources = [run_folder(source, recorded=True) for source in named]
        registry = installed().registry

        def read(source: str) -> Clip:
            return open_clip(source, options, registry)

        stage = build(open_scene(sources, registry, read, options.character))
        page = Page(stage, options.host, free_port(options.host, options.port))
        serve(page, "shows the motion", browser=not options.no_browser)
        return 0

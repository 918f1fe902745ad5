"""Formulas of the site as MathML, which browsers show without a script from elsewhere."""

from __future__ import annotations

from typing import Any

from docutils import nodes


def register_mathematics(app: Any) -> None:
    """Make the HTML writer's renderer of formulas known to Sphinx as ``mathml``."""
    app.add_html_math_renderer("mathml", (_write_inline, None), (_write_block, None))


def _write_inline(writer: Any, node: nodes.Node) -> None:
    writer.body.append(_convert(node, "inline"))
    raise nodes.SkipNode


def _write_block(writer: Any, node: nodes.Node) -> None:
    writer.body.append(f'<div class="math" style="overflow-x:auto">{_convert(node, "block")}</div>')
    raise nodes.SkipNode


def _convert(node: nodes.Node, display: str) -> str:
    from latex2mathml.converter import convert

    return convert(node.astext(), display=display)

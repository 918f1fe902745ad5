"""The tables of the page on scenario files: one section per domain, all keys of each table."""

from __future__ import annotations

from docs.pages.keys import Section, list_sections
from docs.pages.table import make_table
from impact_envs.domain import find_part, list_domains
from impact_envs.scenario import Scenario

HEAD = ("key", "takes", "unit", "default", "meaning")


def write_keys() -> str:
    """Return the tables of all domains; what every domain has stands once, at the top."""
    shared = list(Scenario.model_fields)
    parts = ["## Keys of every scenario\n", _write_section(list_sections(Scenario)[0])]
    parts += [_write_section(section) for section in list_sections(Scenario)[1:]]
    for domain in reversed(list_domains()):
        schema = find_part("impact_envs", domain, "SCHEMA")
        first, *rest = list_sections(schema)
        parts.append(f'## `domain = "{domain}"`\n\n{first.meaning}\n')
        own = [key for key in first.keys if key.name not in shared]
        parts.append(make_table(HEAD, [_make_row(key) for key in own]))
        parts += [_write_section(section) for section in rest if not section.header.startswith("regions")]
    return "\n".join(parts)


def _write_section(section: Section) -> str:
    title = f"### `[{section.header}]`\n\n{section.meaning}\n\n" if section.header else ""
    return title + make_table(HEAD, [_make_row(key) for key in section.keys])


def _make_row(key: tuple[str, str, str, str, str]) -> list[str]:
    name, takes, unit, default, meaning = key
    return [f"`{name}`", takes, unit, default, meaning]

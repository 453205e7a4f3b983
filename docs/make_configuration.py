"""Every key of every configuration file, from the models that validate it.

    python docs/make_configuration.py

writes ``docs/configuration.md`` and, for editors that complete TOML by JSON Schema, a file for each
kind into ``docs/schema``. ``tests/test_docs.py`` holds that both are as the models are.
"""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from bayesbl.config.bench import BenchFile
from bayesbl.config.kinds import FILES, KINDS, SimulateFile

DOCS = Path(__file__).parent
MODELS = {**KINDS, "simulate": SimulateFile, "bench": BenchFile}
Schema = Mapping[str, Any]

HEAD = """# Every key of a configuration

`python docs/make_configuration.py` makes this page from the models that validate the files. A file
is TOML and must state `schema = 1` and its `kind`; paths are relative to it. For an unknown key,
the error names the nearest known one. `bayesbl init` writes a first file, `bayesbl check CONFIG`
checks one without running it. Editors complete keys by the JSON Schemas in `docs/schema` (in Taplo,
by a first line `#:schema docs/schema/compare.json`). In the tables, a key in brackets begins a
section of the file, and a key in bold is required.
"""


def pages() -> dict[Path, str]:
    """What the files should hold."""
    found = {DOCS / "configuration.md": _page()}
    for kind, model in MODELS.items():
        text = json.dumps(_portable(model.model_json_schema()), indent=1, ensure_ascii=False)
        found[DOCS / "schema" / f"{kind}.json"] = text + "\n"
    return found


def _portable(value: Any) -> Any:
    """Without defaults that differ between machines."""
    match value:
        case {"title": "Workers", **rest}:
            return {key: item for key, item in rest.items() if key != "default"}
        case Mapping():
            return {key: _portable(item) for key, item in value.items()}
        case list():
            return [_portable(item) for item in value]
        case _:
            return value


def _page() -> str:
    parts = [HEAD]
    first: dict[tuple[str, str], str] = {}  # the kind that shows a section first
    rows_of: dict[str, list[str]] = {}
    for kind, what in FILES.items():
        schema = MODELS[kind].model_json_schema()
        parts.append(f'## `kind = "{kind}"`: {what}\n')
        parts.append("| key, with its default | value |\n|---|---|")
        own: dict[str, list[str]] = {}
        shared: dict[str, list[str]] = {}
        for name, section in _sections(schema, schema, ""):
            body = _rows(name, section, schema)
            if not body:
                continue
            if body.startswith("| As in "):  # only what it has besides
                head, *rows = body.splitlines()
                body = "\n".join([head, *(row for row in rows if row not in rows_of[name])])
            rows_of.setdefault(name, body.splitlines())
            if name and (name, body) in first:
                shared.setdefault(first[name, body], []).append(f"`{name}`")
            else:
                first[name, body] = kind
                own.setdefault(body, []).append(name)
        for body, names in own.items():
            head = ", ".join(f"`{name}`" for name in names)
            parts.append(f"| **{head}** {body}" if head != "``" else body)
        parts.append("")
        if shared:
            there = (f"as in `{kind}`: {', '.join(names)}" for kind, names in shared.items())
            parts.append(textwrap.fill(f"A{'; '.join(there)[1:]}.", 100) + "\n")
    return "\n".join(parts)


def _sections(whole: Schema, section: Schema, name: str) -> Iterator[tuple[str, Schema]]:
    """Header and schema of a section and of all below it."""
    yield name, section
    for key, value in section.get("properties", {}).items():
        path = f"{name.strip('[]')}.{key}".strip(".")
        for form, inner in _inner(whole, value):
            yield from _sections(whole, inner, form.format(path))


def _inner(whole: Schema, value: Schema) -> Iterator[tuple[str, Schema]]:
    """Form of the header, and schema, of each section that a key holds."""
    for option in (value, *value.get("anyOf", ())):
        if "$ref" in option:
            yield "[{}]", _resolved(whole, option)
        elif "$ref" in option.get("items", {}):
            yield "[[{}]]", _resolved(whole, option["items"])
        elif "$ref" in (option.get("additionalProperties") or {}):
            yield "[{}.NAME]", _resolved(whole, option["additionalProperties"])


def _resolved(whole: Schema, reference: Schema) -> Schema:
    found: Schema = whole["$defs"][reference["$ref"].rpartition("/")[2]]
    return found


def _rows(name: str, section: Schema, whole: Schema) -> str:
    """Its text, and a row for all keys of one value and default."""
    text = " ".join(re.sub(r"``(.+?)``", r"`\1`", section.get("description", "")).split())
    text = text.removeprefix(f"`{name}`: ")
    lines = [f"| {text[:1].upper()}{text[1:]} |"] if name else []
    rows: dict[str, list[str]] = {}
    for key, value in section.get("properties", {}).items():
        if not name and key in ("schema", "kind"):  # of every file
            continue
        if not any(True for _ in _inner(whole, value)) or "anyOf" in value:
            rows.setdefault(_kind(whole, value), []).append(_default(key, value, section))
    lines += [f"| {', '.join(keys)} | {kind} |" for kind, keys in rows.items()]
    return "\n".join(lines)


def _kind(whole: Schema, value: Schema) -> str:
    if "anyOf" in value:
        kinds = [_kind(whole, v) for v in value["anyOf"] if v.get("type") != "null"]
        return " or ".join(dict.fromkeys(kinds))
    if "const" in value:
        return f"`{json.dumps(value['const'])}`"
    if "enum" in value:
        return ", ".join(f"`{json.dumps(v)}`" for v in value["enum"])
    if "$ref" in value:
        return "table"
    match value.get("type"):
        case "array":
            items = value.get("prefixItems") or [value.get("items", {})]
            inner = [_kind(whole, item) for item in items]
            if len(inner) == 2 and len(set(inner)) == 1:
                return f"[low, high], each a {inner[0]}"
            return f"[{', '.join(inner)}{'' if 'prefixItems' in value else ', …'}]"
        case "object":
            inner = value.get("additionalProperties")
            is_typed = isinstance(inner, Mapping) and inner
            return f"table; values: {_kind(whole, inner)}" if is_typed else "table"
        case "string":
            return {"path": "path", "date": "date"}.get(value.get("format", ""), "text")
        case "boolean":
            return "boolean"
        case "number" | "integer" as number:
            bounds = [
                f"{sign} {value[key]:g}"
                for key, sign in (
                    ("minimum", "≥"),
                    ("exclusiveMinimum", ">"),
                    ("maximum", "≤"),
                    ("exclusiveMaximum", "<"),
                )
                if key in value and abs(value[key]) < 1e18
            ]
            if "minimum" in value and "maximum" in value:
                return f"{number} from {value['minimum']:g} to {value['maximum']:g}"
            return f"{number} {' and '.join(bounds)}".rstrip()
        case _:
            return "any"


def _default(key: str, value: Schema, section: Schema) -> str:
    """A key with its default, in bold if it is required."""
    if key == "name" and "file" in section["properties"]:
        return f"`{key}` (from the file name)"
    either = [kind["required"] for kind in section.get("anyOf", ())]
    if [key] in either:
        return f"**`{key}`** or " + " or ".join(f"**`{k}`**" for (k,) in either if k != key)
    if key in section.get("required", ()):
        return f"**`{key}`**"
    if value.get("default") is None:
        return f"`{key}` (all cores)" if key == "workers" else f"`{key}`"
    if key == "route" and "bench" in section["properties"]:
        return f'`{key} = "auto"` with a bench, else `"amplitude"`'
    return f"`{key} = {json.dumps(value['default'])}`"


if __name__ == "__main__":
    (DOCS / "schema").mkdir(exist_ok=True)
    for file, content in pages().items():
        file.write_text(content, encoding="utf-8")

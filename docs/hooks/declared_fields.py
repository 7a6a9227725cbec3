"""What the reference shows of the code beyond its docstrings.

The documentation of a field stands beside it: in `quantity("N", "what it is")`, or in a comment of its line.
"""

import ast
import re
from typing import Any

import griffe

DECLARING = {"quantity", "amplitude", "positive"}


class DeclaredFields(griffe.Extension):
    """Lists the fields of a class below its docstring, with what their lines say of them; makes links of pages."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """A page that a docstring names, such as docs/method/tuning.md, becomes a link from the reference to it."""
        if obj.docstring is not None:
            obj.docstring.value = re.sub(r"\bdocs/([\w/-]+)\.md", r"[\1](../../\1.md)", obj.docstring.value)

    def on_class_members(self, *, cls: griffe.Class, **_: Any) -> None:
        """Add the section; a class that has one keeps it."""
        fields = {name: _said(member) for name, member in cls.members.items() if _is_field(member)}
        rows = [f"    {name}: {said}" for name, said in fields.items() if said]
        if not rows or (cls.docstring and "Attributes:" in cls.docstring.value):
            return
        section = "\n".join(["Attributes:", *rows])
        if cls.docstring is None:
            cls.docstring = griffe.Docstring(section, parent=cls)
        else:
            cls.docstring.value = f"{cls.docstring.value.rstrip()}\n\n{section}\n"


def _is_field(member: Any) -> bool:
    if not member.is_attribute or not member.is_public or member.docstring is not None or "property" in member.labels:
        return False
    return member.annotation is not None and "ClassVar" not in str(member.annotation)


def _said(field: griffe.Attribute) -> str:
    return _declared(field) or _commented(field)


def _declared(field: griffe.Attribute) -> str:
    """What a call of `quantity` declares: the meaning, the unit, and the default where there is one."""
    call = None if field.value is None else ast.parse(str(field.value), mode="eval").body
    if not isinstance(call, ast.Call) or getattr(call.func, "id", None) not in DECLARING:
        return ""
    texts = [one.value for one in call.args if isinstance(one, ast.Constant) and isinstance(one.value, str)]
    given = {one.arg: ast.unparse(one.value) for one in call.keywords}
    default = "0.0" if call.func.id == "amplitude" else given.get("usual", given.get("default"))  # type: ignore[attr-defined]
    unit, meaning = texts[0], texts[1]
    text = f"{meaning[0].upper()}{meaning[1:]}{f' ({unit})' if unit not in ('', '1') else ''}"
    return f"{text}; default {default}." if default not in (None, "None") else f"{text}."


def _commented(field: griffe.Attribute) -> str:
    """The comment at the end of its line."""
    if field.lineno is None:
        return ""
    line = field.lines_collection[field.filepath][(field.endlineno or field.lineno) - 1]
    found = re.search(r"\s{2}#\s+(?!noqa|type:|fmt:)(.+)$", line)
    return "" if found is None else f"{found[1][0].upper()}{found[1][1:]}."

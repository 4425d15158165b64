"""Hook of the site's generator: links that leave docs/ lead to the API reference, or become plain text."""

from __future__ import annotations

import re
from typing import Any

LINK = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+)([^)\s]+)\)")


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Rewrite the links of one page, which in the repository lead to the source."""
    depth = page.file.src_uri.count("/")

    def target(match: re.Match[str]) -> str:
        text, up, path = match.groups()
        if len(up) // 3 <= depth:
            return match[0]  # another page of the documentation
        parts = path.removesuffix(".py").removesuffix("/__init__").split("/")
        if parts[0] != "shmoo_mjx" or not path.endswith(".py") or len(parts) < 2:
            return text
        folder = parts[1] if len(parts) > 2 or path.endswith("__init__.py") else "basics"
        return f"[{text}]({'../' * depth}reference/{folder}.md#{'.'.join(parts)})"

    return LINK.sub(target, markdown)

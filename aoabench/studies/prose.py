"""The little Markdown that the studies' readings use, as HTML: headings, paragraphs, lists, tables,
code, emphasis.
"""

from __future__ import annotations

import re
from html import escape

_START = re.compile(r"(#+ |[-*] |\d+\. |\||```)")  # what ends a paragraph that goes on over lines


def html(text: str, level: int = 4) -> str:
    """HTML of a Markdown text without its title; second-level headings become <h`level`>."""
    out: list[str] = []
    for block in _blocks(text.splitlines()):
        first = block[0]
        if first.startswith("```"):
            out.append(f"<pre>{escape(chr(10).join(block[1:]))}</pre>")
        elif first.startswith("# "):
            continue
        elif first.startswith("#"):
            depth = level + len(first) - len(first.lstrip("#")) - 2
            out.append(f"<h{depth}>{inline(first.lstrip('# '))}</h{depth}>")
        elif first.startswith("|"):
            out.append(_table(block))
        elif re.match(r"([-*]|\d+\.) ", first):
            tag = "ul" if first[0] in "-*" else "ol"
            items = "".join(
                f"<li>{inline(re.sub(r'^([-*]|[0-9]+[.]) ', '', line))}</li>" for line in block
            )
            out.append(f"<{tag}>{items}</{tag}>")
        else:
            out.append(f"<p>{inline(' '.join(block))}</p>")
    return "\n".join(out)


def inline(text: str) -> str:
    """Code, bold, emphasis and the words of links; everything else is escaped."""
    pieces = re.split(r"(`[^`]+`)", text)
    for i, piece in enumerate(pieces):
        if i % 2:
            pieces[i] = f"<code>{escape(piece[1:-1])}</code>"
        else:
            safe = re.sub(r"\[([^\]]+)\]\([^)]+\)", r"\1", escape(piece, quote=False))
            safe = re.sub(r"\*\*(.+?)\*\*", r"<strong>\1</strong>", safe)
            pieces[i] = re.sub(r"(?<![\w*])\*(\S(?:.*?\S)?)\*(?![\w*])", r"<em>\1</em>", safe)
    return "".join(pieces)


def _blocks(lines: list[str]) -> list[list[str]]:
    """Headings, code, tables, lists (one line per item) and paragraphs, each a list of lines."""
    blocks: list[list[str]] = [[]]
    for line in lines:
        block = blocks[-1]
        if block and block[0].startswith("```"):
            blocks.append([]) if line.startswith("```") else block.append(line)
        elif not line.strip():
            blocks.append([])
        elif line.startswith((" ", "\t")) and block and re.match(r"([-*]|\d+\.) ", block[0]):
            block[-1] += " " + line.strip()
        elif not _START.match(line):
            if block and (block[0].startswith("#") or block[0].startswith("|")):
                blocks.append([line])
            elif block and _START.match(block[0]):
                block[-1] += " " + line.strip()
            else:
                block.append(line)
        elif block and _kind(block[0]) == _kind(line) and not line.startswith(("#", "```")):
            block.append(line)
        else:
            blocks.append([line])
    return [block for block in blocks if block]


def _kind(line: str) -> str:
    return "1" if line[0].isdigit() else line[0]


def _table(lines: list[str]) -> str:
    rows = [
        re.split(r"(?<!\\)\|", line.strip().strip("|"))
        for line in lines
        if not re.fullmatch(r"[|:\- ]+", line)
    ]

    def row(cells: list[str], tag: str) -> str:
        return (
            "<tr>" + "".join(f"<{tag}>{inline(cell.strip())}</{tag}>" for cell in cells) + "</tr>"
        )

    body = "".join(row(cells, "td") for cells in rows[1:])
    return (
        f'<div class="scroll"><table><thead>{row(rows[0], "th")}</thead>'
        f"<tbody>{body}</tbody></table></div>"
    )

"""All pages of the reference, by name."""

from __future__ import annotations

from functools import cache

from coopqp_site import api, commands, reference

INDEX = """# Everything by name

Made from the code while the site is built: from docstrings, the form that reads scenario files and
the command line itself. What is in them by letter: {{ref}}`genindex`.

```{{toctree}}
:maxdepth: 1

{pages}
```
"""


@cache
def written() -> dict[str, str]:
    """Text of each page of the reference, by its name; made once, to be read only."""
    pages = {**dict(reference.pages()), "command_line.md": commands.page(), **dict(api.pages())}
    listed = [name.removesuffix(".md") for name in pages if "/" not in name]
    listed.remove("python")  # docs/index.md has it
    return {"index.md": INDEX.format(pages="\n".join(listed)), **pages}

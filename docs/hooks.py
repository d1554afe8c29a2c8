"""MkDocs hooks of armctl: fences and links that also work on GitHub, and pages from other folders."""

import os
import re
from pathlib import Path, PurePosixPath

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from notebook_page import as_markdown

ROOT = Path(__file__).parents[1]
GITHUB = "https://github.com/armctl/armctl"
GUESTS = {
    "changelog.md": "CHANGELOG.md",
    "contributing.md": "CONTRIBUTING.md",
    "security.md": "SECURITY.md",
    "zoo.md": "rl/README.md",
}
"""Pages of the site from other folders of the repository."""
NOTEBOOKS = {
    f"notebooks/{path.stem}.md": f"notebooks/{path.name}"
    for path in (ROOT / "notebooks").glob("*.ipynb")
}

NOTE = re.compile(r"^```(\w+) (?:not run: .*|([^\s=]+)( \S+)?)$", re.MULTILINE)
"""Text after a fence's language: why it is not run, its file, or the file and the names of an excerpt."""
LINK = re.compile(r"(?<=\]\()([^):#\s]+)(?=[#)])")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages from other folders, and the notebooks with their pictures."""
    for page, source in GUESTS.items():
        files.append(
            File.generated(config, page, abs_src_path=str(ROOT / source))
        )
    for page, source in NOTEBOOKS.items():
        text, pictures = as_markdown(ROOT / source)
        files.append(File.generated(config, page, content=text))
        for name, picture in pictures.items():
            files.append(
                File.generated(config, f"notebooks/{name}", content=picture)
            )
    return files


def on_page_markdown(
    markdown: str, page: Page, config: MkDocsConfig, files: Files
) -> str:
    """Return a page with titles instead of notes on fences, and with the links of the site."""
    source = source_of(page.file.src_uri)
    page.edit_url = f"{GITHUB}/edit/main/{source}"
    return LINK.sub(
        lambda link: as_in_site(link[0], page.file.src_uri, files),
        NOTE.sub(titled, markdown),
    )


def source_of(page: str) -> str:
    """Return the path of a page's source in the repository."""
    return GUESTS.get(page) or NOTEBOOKS.get(page) or f"docs/{page}"


def as_in_site(link: str, page: str, files: Files) -> str:
    """Return a link of the repository as a link to the page in the site, or else to the file on GitHub."""
    target = os.path.normpath(PurePosixPath(source_of(page)).parent / link)
    pages = {source: one for one, source in (GUESTS | NOTEBOOKS).items()}
    in_site = pages.get(target, target.removeprefix("docs/"))
    if (
        in_site in files.src_uris
        and not files.src_uris[in_site].inclusion.is_excluded()
    ):
        return os.path.relpath(in_site, PurePosixPath(page).parent)
    return f"{GITHUB}/blob/main/{target}" if (ROOT / target).exists() else link


def titled(fence: re.Match[str]) -> str:
    """Return a fence for the site's highlighter."""
    language, file, _ = fence.groups()
    return f'```{language} title="{file}"' if file else f"```{language}"

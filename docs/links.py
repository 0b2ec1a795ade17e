"""Check links: between the pages of a built site, or to other sites.

`python docs/links.py target/docs` prints every link to a missing file or anchor. `python docs/links.py --external
docs/external-links.txt` requests each listed address and prints those that give no page. Both exit with 1 if there is
one. Only the second form reads the network.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.error import HTTPError, URLError
from urllib.parse import unquote, urlsplit
from urllib.request import Request, urlopen

#: Folders of the site that Sphinx does not write; their pages count as targets only.
FOREIGN = ("_static", "playground", "rust", "versions")


class Page(HTMLParser):
    """The anchors of a page, and the addresses that it links or loads."""

    def __init__(self, text: str) -> None:
        """Read a page."""
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect the attributes that name an anchor or an address."""
        for name, value in attrs:
            if name == "id" or (tag == "a" and name == "name"):
                self.anchors.add(value or "")
            elif name in ("href", "src"):
                self.links.append(value or "")


def broken_links(site: Path) -> tuple[int, list[str]]:
    """Return the number of links inside a site, and a line for each broken one."""
    pages = {
        path.resolve(): Page(path.read_text(encoding="utf-8"))
        for path in sorted(site.rglob("*.html"))
        if path.relative_to(site).parts[0] not in FOREIGN
    }
    found = list(_links(pages))
    broken = []
    for page, link, target, anchor in found:
        if not target.is_file():
            reason = "no such file"
        elif anchor and target in pages and anchor not in pages[target].anchors:
            reason = "no such anchor"
        else:
            continue
        broken.append(f"{page.relative_to(site.resolve())}: {link}: {reason}")
    return len(found), broken


def _links(pages: dict[Path, Page]) -> Iterator[tuple[Path, str, Path, str]]:
    """Yield the page, the address, the file and the anchor of each link inside the site."""
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            yield path, link, target, unquote(parts.fragment)


def dead_addresses(addresses: Iterable[str]) -> list[str]:
    """Return a line for each address that gives no page."""
    dead = []
    for address in addresses:
        request = Request(address, headers={"User-Agent": "Mozilla/5.0 (checks links)"})
        try:
            with urlopen(request, timeout=30):
                pass
        except HTTPError as error:
            # Some servers refuse programs; the page exists.
            if error.code not in (403, 405, 429):
                dead.append(f"{address}: {error.code} {error.reason}")
        except (URLError, OSError) as error:
            dead.append(f"{address}: {error}")
    return dead


def check_external(listing: Path) -> int:
    """Print the listed addresses that give no page, then the number of addresses."""
    lines = listing.read_text(encoding="utf-8").splitlines()
    addresses = [line for line in lines if line and not line.startswith("#")]
    dead = dead_addresses(addresses)
    for line in dead:
        print(line, file=sys.stderr)
    print(f"{len(addresses)} links to other sites, {len(dead)} dead")
    return 1 if dead or not addresses else 0


def main(site: Path) -> int:
    """Print the broken links, then the number of links."""
    count, broken = broken_links(site)
    for line in broken:
        print(line, file=sys.stderr)
    print(f"{count} links inside the site, {len(broken)} broken")
    return 1 if broken or not count else 0


if __name__ == "__main__":
    sys.exit(check_external(Path(sys.argv[2])) if sys.argv[1] == "--external" else main(Path(sys.argv[1])))

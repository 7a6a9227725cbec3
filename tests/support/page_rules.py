"""What every page keeps: well-formed, self-contained, safe, and readable without eyes, as far as its text can tell."""

import base64
import hashlib
import itertools
import json
import re
from html.parser import HTMLParser
from urllib.parse import unquote

VOID = {"meta", "img", "br", "hr"}
HEADINGS = ("h1", "h2", "h3", "h4")
LOADED = {"src", "srcset", "poster", "data", "action", "formaction", "background", "ping", "manifest", "xlink:href"}


class Page(HTMLParser):
    """The elements of a page in order, with what stands in each; raises where one is not closed."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.text, self.elements, self.open = text, [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        names = [name for name, _ in attributes]
        assert len(set(names)) == len(names), f"{tag} has an attribute twice"
        element = {"tag": tag, "text": "", "in": [one["tag"] for one in self.open]} | {"attributes": dict(attributes)}
        self.elements.append(element)
        if tag not in VOID:
            self.open.append(element)

    def handle_startendtag(self, tag, attributes):
        assert tag == "path", f"<{tag}/> is for drawings alone"
        self.handle_starttag(tag, attributes)
        self.open.pop()

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open[-1]["tag"] == tag, f"</{tag}> closes <{self.open[-1]['tag']}>"
        self.open.pop()

    def handle_data(self, data):
        for element in self.open:
            element["text"] += data

    def all(self, *tags):
        return [one for one in self.elements if one["tag"] in tags]

    def one(self, tag):
        [found] = self.all(tag)
        return found

    def readable(self):
        """What a reader sees, in one line."""
        kept = re.sub(r"<(script|style)\b.*?</\1>", "", self.text, flags=re.S)
        return " ".join(Page(kept).one("body")["text"].split())


def assert_keeps_the_rules(path):
    """A page on a disk: its structure, its safety, its links, its size; returns it."""
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert text.startswith("<!doctype html>")
    assert len(text.encode()) < 8_000_000
    assert page.one("html")["attributes"]["lang"] == "en"
    assert page.one("title")["text"].strip()
    quoting = re.sub(r"<script>.*?</script>", "", text, flags=re.S)  # all but the page's own programs
    assert not [c for c in quoting if ord(c) < 32 and c != "\n"]
    assert not re.search("[\u202a-\u202e\u2066-\u2069\u200e\u200f\x7f-\x9f]", quoting)
    _structure(page)
    _safety(page)
    _links(page, path.parent)
    return page


def _structure(page):
    levels = [int(one["tag"][1]) for one in page.all(*HEADINGS)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))
    assert all(one["text"].strip() for one in page.all(*HEADINGS, "button", "a", "caption", "figcaption"))
    assert all(one["attributes"]["alt"].strip() for one in page.all("img"))
    assert all(one["attributes"].get("scope") in ("col", "row") for one in page.all("th"))
    for tag in ("main", "header", "footer"):
        page.one(tag)
    ids = [one["attributes"]["id"] for one in page.elements if "id" in one["attributes"]]
    assert len(set(ids)) == len(ids)
    rows = re.findall(r"<tr>(.*?)</tr>", page.text)
    assert all(row.count("<t") for row in rows)


def _safety(page):
    assert not page.all("iframe", "object", "embed", "base", "link", "form", "input", "audio", "video", "foreignobject")
    for one in page.elements:
        for name, value in one["attributes"].items():
            assert not name.startswith("on"), f"<{one['tag']} {name}>"
            if name in LOADED:
                assert value.startswith("data:image/png;base64,")
            assert name != "style"
    [policy] = [
        one["attributes"]["content"]
        for one in page.all("meta")
        if one["attributes"].get("http-equiv") == "Content-Security-Policy"
    ]
    assert policy.startswith("default-src 'none'; ")
    allowed = re.search(r"script-src ([^;]*);", policy).group(1).split()
    run = [one for one in page.all("script") if "type" not in one["attributes"]]
    digests = [base64.b64encode(hashlib.sha256(one["text"].encode()).digest()).decode() for one in run]
    assert sorted(allowed) == sorted(f"'sha256-{one}'" for one in digests)
    assert page.text.index("Content-Security-Policy") < page.text.index("<script")
    for one in page.all("script"):
        if "type" in one["attributes"]:
            assert one["attributes"]["type"] == "application/json"
            json.loads(one["text"])
    assert "url(" not in page.one("style")["text"]
    assert "@import" not in page.one("style")["text"]


def _links(page, folder):
    ids = {one["attributes"].get("id") for one in page.elements}
    for one in page.all("a"):
        target = one["attributes"]["href"]
        if target.startswith("#"):
            assert target[1:] in ids
        else:
            assert target.startswith("./")
            assert (folder / unquote(target[2:], errors="surrogateescape")).is_file(), target

"""What a hand does on the page of `diffdrive app`, and what an eye sees there."""

import time


def text(tab):
    return tab.find_element("tag name", "body").text


def until(tab, words, seconds=120.0):
    """Wait until the page says so; never is there a traceback on it."""
    ends = time.monotonic() + seconds
    while words not in (now := text(tab)):
        assert "Traceback" not in now
        assert time.monotonic() < ends, f"no '{words}' in:\n{now}"
        time.sleep(0.3)
    assert "Traceback" not in now


def drop(tab, *paths):
    """Drag files from the disk over the page, and let them go: the browser's own events, not the field behind them."""
    until(tab, "Drop traces")
    at = tab.execute_script(
        "const at = document.querySelector('.dd-drop').getBoundingClientRect(); return [at.x, at.y]"
    )
    data = {"items": [], "files": [str(path) for path in paths], "dragOperationsMask": 1}
    for kind in ("dragEnter", "dragOver", "drop"):
        event = {"type": kind, "x": at[0] + 30, "y": at[1] + 30, "data": data}
        tab.execute_cdp_cmd("Input.dispatchDragEvent", event)


def choose(tab, *paths):
    until(tab, "Drop traces")
    tab.find_element("css selector", ".dd-drop input").send_keys("\n".join(map(str, paths)))


def press(tab, words):
    ends = time.monotonic() + 30.0
    while True:
        found = [one for one in tab.find_elements("xpath", f"//button[contains(., '{words}')]") if one.is_displayed()]
        try:
            found[-1].click()
            return
        except Exception:  # it is drawn anew just now
            assert time.monotonic() < ends, f"no button '{words}' in:\n{text(tab)}"
            time.sleep(0.3)

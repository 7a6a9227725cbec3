// Sends files that are dropped anywhere on the first page, or chosen, one after the other; names are only ever shown as text.
(() => {
  const waiting = [];
  let sending = false;

  const line = (name) => {
    const place = document.getElementById("dd-sending");
    const box = document.createElement("div");
    box.className = "dd-sending";
    box.setAttribute("role", "status");
    const text = document.createElement("div");
    text.className = "dd-wrap";
    const bar = document.createElement("progress");
    bar.max = 1;
    bar.value = 0;
    bar.setAttribute("aria-label", "sent of " + name);
    text.textContent = name;
    box.append(text, bar);
    if (place) place.append(box);
    return { box, text, bar };
  };

  const fail = (shown, why) => {
    shown.text.textContent = why;
    shown.text.classList.add("dd-bad");
    shown.bar.remove();
    const close = document.createElement("button");
    close.type = "button";
    close.textContent = "Dismiss";
    close.onclick = () => shown.box.remove();
    shown.box.append(close);
  };

  const next = () => {
    if (sending || !waiting.length) return;
    sending = true;
    const { file, shown } = waiting.shift();
    const request = new XMLHttpRequest();
    request.open("POST", "/take?name=" + encodeURIComponent(file.name));
    request.upload.onprogress = (event) => {
      if (event.lengthComputable && event.total) shown.bar.value = event.loaded / event.total;
    };
    const done = () => { sending = false; next(); };
    request.onload = () => {
      if (request.status === 200) {
        shown.box.remove();
        document.dispatchEvent(new CustomEvent("dd-taken"));
      } else {
        fail(shown, request.responseText || "could not be kept");
      }
      done();
    };
    request.onerror = () => {
      fail(shown, file.name + ": the connection was lost; see that the app runs, and drop it again");
      done();
    };
    request.send(file);
  };

  const send = (files, folders = []) => {
    for (const name of folders) fail(line(name), name + ": is a folder; drop the files in it");
    for (const file of files) waiting.push({ file, shown: line(file.name) });
    next();
  };

  const zone = () => document.querySelector(".dd-drop");
  // text that is dragged within the page, or into a field, is the browser's
  const hasFiles = (event) => [...(event.dataTransfer?.types || [])].includes("Files");

  addEventListener("beforeunload", (event) => { if (sending) event.preventDefault(); });
  addEventListener("dragover", (event) => {
    if (!hasFiles(event)) return;
    event.preventDefault(); // else the browser leaves the page for the file
    event.dataTransfer.dropEffect = zone() ? "copy" : "none";
    zone()?.classList.add("over");
  });
  addEventListener("dragleave", () => zone()?.classList.remove("over"));
  addEventListener("drop", (event) => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    zone()?.classList.remove("over");
    if (!zone()) return;
    const entries = [...event.dataTransfer.items].map((item) => item.webkitGetAsEntry?.());
    const folders = entries.filter((entry) => entry?.isDirectory).map((entry) => entry.name);
    send([...event.dataTransfer.files].filter((file) => !folders.includes(file.name)), folders);
  });
  document.addEventListener("change", (event) => {
    if (event.target.matches(".dd-drop input")) {
      send([...event.target.files]);
      event.target.value = "";
    }
  });
})();

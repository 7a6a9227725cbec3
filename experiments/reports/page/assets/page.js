"use strict";
(() => {
  const root = document.documentElement;
  const wide = () => document.querySelectorAll(".scroll").forEach(box => {
    // a stop of the tabulator only where there is something to scroll
    const more = box.scrollWidth > box.clientWidth;
    if (more) box.tabIndex = 0; else box.removeAttribute("tabindex");
    box.classList.toggle("scrolls", more);
  });
  wide();
  addEventListener("resize", wide);
  if (!window.Plotly) return;
  const colour = name => getComputedStyle(root).getPropertyValue(name).trim();
  const axesOf = (layout, letter) => Object.keys(layout).filter(key => key.startsWith(letter + "axis"));
  const coarse = matchMedia("(pointer: coarse)").matches;  // a finger scrolls the page; the buttons zoom
  const dress = spec => {
    const ink = colour("--ink"), line = colour("--line");
    spec.data.forEach(trace => {
      const one = colour("--c" + trace.meta);
      if (trace.line) trace.line.color = one;
      if (trace.marker) trace.marker.color = one;
    });
    Object.assign(spec.layout, {
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: {color: ink, size: 12},
      hovermode: "closest", dragmode: coarse ? false : "zoom"
    });
    ["x", "y"].forEach(letter => axesOf(spec.layout, letter).forEach(key => Object.assign(spec.layout[key], {
      gridcolor: line, zerolinecolor: line, linecolor: line, showline: true, tickcolor: line
    })));
    return spec;
  };
  const zoom = (plot, factor, shift) => {
    const change = {};
    axesOf(plot.layout, "x").forEach(key => {
      const [low, high] = plot._fullLayout[key].range;
      const middle = (low + high) / 2 + shift * (high - low), half = factor * (high - low) / 2;
      change[key + ".range"] = [middle - half, middle + half];
    });
    Plotly.relayout(plot, change);
  };
  const all = plot => {
    const change = {};
    ["x", "y"].forEach(letter => axesOf(plot.layout, letter).forEach(key => { change[key + ".autorange"] = true; }));
    Plotly.relayout(plot, change);
  };
  const acts = {
    in: plot => zoom(plot, 0.5, 0), out: plot => zoom(plot, 2, 0), left: plot => zoom(plot, 1, -0.25),
    right: plot => zoom(plot, 1, 0.25), all
  };
  const charts = [...document.querySelectorAll(".chart")].map(chart => {
    const plot = chart.querySelector(".plot");
    const text = chart.querySelector("script[type='application/json']").textContent;
    chart.querySelectorAll("[data-do]").forEach(button => {
      button.addEventListener("click", () => acts[button.dataset.do](plot));
    });
    chart.querySelectorAll("[data-traces]").forEach(button => button.addEventListener("click", () => {
      const shown = button.getAttribute("aria-pressed") !== "true";
      button.setAttribute("aria-pressed", shown);
      Plotly.restyle(plot, {visible: shown}, button.dataset.traces.split(" ").map(Number));
    }));
    return {plot, spec: JSON.parse(text)};
  });
  root.classList.add("js");
  const draw = ({plot, spec}) => {
    try {
      Plotly.react(plot, dress(spec).data, spec.layout, {displayModeBar: false, responsive: true, displaylogo: false});
    } catch (problem) {
      root.classList.remove("js");  // the pictures show the same
      throw problem;
    }
  };
  charts.forEach(draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => charts.forEach(draw));
  // at this event style and widths are the paper's; a browser without it prints what it has drawn, made smaller
  matchMedia("print").addEventListener("change", ({matches}) => {
    root.classList.toggle("paper", matches);
    charts.forEach(chart => {
      const {layout} = chart.spec, width = chart.plot.clientWidth;
      if (!width) return;  // its picture is printed
      if (matches) layout.width = width; else delete layout.width;
      layout.autosize = !matches;
      draw(chart);
    });
  });
})();

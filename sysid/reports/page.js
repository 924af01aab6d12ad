// Draws the figures when they come into view, in the colours of the reader's theme. Loads nothing.
"use strict";
(() => {
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const island = (id) => JSON.parse(document.getElementById(id).textContent);

  // "$before" anywhere in a figure stands for the CSS variable --before.
  const themed = (value) => {
    if (typeof value === "string") return value.startsWith("$") ? colour(value.slice(1)) : value;
    if (Array.isArray(value)) return value.map(themed);
    if (value && typeof value === "object" && !ArrayBuffer.isView(value)) {
      return Object.fromEntries(Object.entries(value).map(([key, item]) => [key, key === "bdata" ? item : themed(item)]));
    }
    return value;
  };

  const axis = () => ({
    gridcolor: colour("faint"), zerolinecolor: colour("rule"), linecolor: colour("rule"), tickcolor: colour("rule"),
    tickfont: { size: 12, color: colour("quiet") }, automargin: true,
  });

  const layoutOf = (layout) => {
    const base = {
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", margin: { l: 62, r: 18, t: 34, b: 44 },
      font: { family: getComputedStyle(document.body).fontFamily, size: 13, color: colour("ink") }, separators: ". ",
      hoverlabel: { bgcolor: colour("panel"), bordercolor: colour("rule"), font: { color: colour("ink") } },
      legend: { orientation: "h", x: 0, y: 1.01, yanchor: "bottom" },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("noise"), activecolor: colour("ink") },
    };
    const result = { ...base, ...themed(layout) };
    for (const key of new Set([...Object.keys(result).filter((name) => /^[xy]axis\d*$/.test(name)), "xaxis", "yaxis"])) {
      const given = result[key] ?? {};
      const title = typeof given.title === "string" ? { text: given.title } : given.title;
      result[key] = { ...axis(), ...given, ...(title ? { title: { font: { size: 12.5, color: colour("quiet") }, ...title } } : {}) };
    }
    return result;
  };

  const config = {
    displaylogo: false, responsive: true, plotlyServerURL: "", modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
    toImageButtonOptions: { format: "svg", filename: document.title },
  };
  const draw = (element, data, layout) => Plotly.react(element, themed(data), layoutOf(layout), config);

  const drawings = new Map();
  document.querySelectorAll("[data-figure]").forEach((element) => {
    const spec = island(element.dataset.figure);
    drawings.set(element, () => draw(element, spec.data, spec.layout));
  });

  const explorer = document.getElementById("traces-figure");
  if (explorer) {
    const recordings = island("traces-data").recordings;
    const decode = (packed) => new Float32Array(Uint8Array.from(atob(packed.bdata), (c) => c.charCodeAt(0)).buffer);
    const chosenSignal = document.getElementById("traces-signal");
    const chosenRecording = document.getElementById("traces-recording");
    const repaired = explorer.dataset.repaired === "yes";
    const show = () => {
      const recording = recordings[chosenRecording ? chosenRecording.value : Object.keys(recordings)[0]];
      const signal = recording.signals[chosenSignal.value];
      const [time, measured, before, after] = [recording.time, signal.measured, signal.before, signal.after].map(decode);
      const minus = (a, b) => a.map((value, i) => value - b[i]);
      const line = (name, y, color, width, row, extra = {}) => ({
        type: "scatter", mode: "lines", name, x: time, y, line: { color, width }, yaxis: `y${row}`, connectgaps: false,
        hovertemplate: `${row === "2" ? "error " : ""}${name} %{y:.4~g}${row === "3" ? "" : `\u202f${signal.unit}`}<extra></extra>`, ...extra,
      });
      const data = [
        line("before", before, "$before", 1.6, "", { legendgroup: "before" }),
        ...(repaired ? [line("after", after, "$after", 1.8, "", { legendgroup: "after" })] : []),
        line("measured", measured, "$measured", 1.3, "", { line: { color: "$measured", width: 1.4, dash: "dot" } }),
        line("before", minus(before, measured), "$before", 1.2, "2", { legendgroup: "before", showlegend: false }),
        ...(repaired ? [line("after", minus(after, measured), "$after", 1.2, "2", { legendgroup: "after", showlegend: false })] : []),
      ];
      const owner = chosenSignal.value.split(".")[0];
      const axes = owner in recording.commands ? [owner] : Object.keys(recording.commands);
      const shades = ["$c1", "$c2", "$c3", "$c4"];
      axes.forEach((name, i) => data.push(line(axes.length > 1 ? `command ${name}` : "command", decode(recording.commands[name]),
        axes.length > 1 ? shades[i % shades.length] : "$quiet", 1.1, "3", { legendgroup: `command ${name}`, showlegend: axes.length > 1 })));
      const unit = signal.unit ? ` [${signal.unit}]` : "";
      const band = { type: "rect", xref: "paper", x0: 0, x1: 1, yref: "y2", y0: -2 * signal.floor, y1: 2 * signal.floor,
        fillcolor: "$band", line: { width: 0 }, layer: "below" };
      draw(explorer, data, {
        xaxis: { title: { text: "time [s]", standoff: 6 }, anchor: "y3", unifiedhovertitle: { text: "%{x:.2f}\u202fs" } },
        yaxis: { title: `${chosenSignal.selectedOptions[0].text}${unit}`, domain: [0.5, 1] },
        yaxis2: { title: `error${unit}`, domain: [0.2, 0.45], zeroline: true },
        yaxis3: { title: "command", domain: [0, 0.15] },
        shapes: signal.floor > 0 ? [band] : [], hovermode: "x unified", margin: { l: 66, r: 18, t: 58, b: 52 },
      });
    };
    const save = () => {
      const recording = recordings[chosenRecording ? chosenRecording.value : Object.keys(recordings)[0]];
      const signal = recording.signals[chosenSignal.value];
      const names = ["measured", "before", ...(repaired ? ["after"] : [])];
      const commands = Object.keys(recording.commands);
      const columns = [recording.time, ...names.map((name) => signal[name]), ...commands.map((name) => recording.commands[name])].map(decode);
      const title = (name) => `${chosenSignal.value} ${name}${signal.unit ? ` [${signal.unit}]` : ""}`;
      const header = ["time [s]", ...names.map(title), ...commands.map((name) => `${name}.command`)];
      const text = (value) => (Number.isFinite(value) ? String(value) : "");
      const rows = Array.from(columns[0], (_, i) => columns.map((column) => text(column[i])).join(","));
      const address = URL.createObjectURL(new Blob([[header.join(","), ...rows, ""].join("\n")], { type: "text/csv" }));
      Object.assign(document.createElement("a"), { href: address, download: `${chosenSignal.value}.csv` }).click();
      setTimeout(() => URL.revokeObjectURL(address), 10000);
    };
    document.getElementById("traces-csv").addEventListener("click", save);
    chosenSignal.addEventListener("change", show);
    if (chosenRecording) chosenRecording.addEventListener("change", show);
    drawings.set(explorer, show);
  }

  const drawn = new Set();
  const drawOnce = (element) => {
    if (drawn.has(element)) return;
    drawn.add(element);
    drawings.get(element)();
  };
  const seen = new IntersectionObserver((entries) => {
    for (const { isIntersecting, target } of entries) if (isIntersecting) drawOnce(target);
  }, { rootMargin: "600px" });
  for (const element of drawings.keys()) seen.observe(element);
  // On paper are the sections that are unfolded; their figures are drawn at its size.
  const paper = 900;  // [px], of a sheet of A4 with the margins of a browser, at the zoom of the style sheet
  const printed = () => [...drawings.keys()].filter((element) => !element.closest("details:not([open])"));
  addEventListener("beforeprint", () => {
    for (const element of printed()) {
      drawOnce(element);
      Plotly.relayout(element, { autosize: false, width: Math.min(paper, element.clientWidth), height: Math.min(400, element.clientHeight) });
    }
  });
  addEventListener("afterprint", () => {
    for (const element of printed()) Plotly.relayout(element, { autosize: true, width: null, height: null });
  });
  // The link to the section in view.
  const links = new Map([...document.querySelectorAll("nav a")].map((link) => [link.hash.slice(1), link]));
  const sections = [...document.querySelectorAll("main > section")];
  const mark = () => {
    const current = sections.filter((section) => section.getBoundingClientRect().top < innerHeight / 3).at(-1) ?? sections[0];
    for (const [id, link] of links) {
      if (id === current?.id) link.setAttribute("aria-current", "true"); else link.removeAttribute("aria-current");
    }
  };
  addEventListener("scroll", mark, { passive: true });
  mark();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawn.forEach((element) => drawings.get(element)()));
})();

"use strict";
// The properties of two items side by side. The choice is kept in the address: #a=KEY&b=KEY.
(() => {
  const items = JSON.parse(document.getElementById("items").textContent);
  const [a, b, different] = ["a", "b", "different"].map((id) => document.getElementById(id));
  const body = document.getElementById("compared").tBodies[0];
  const cell = (row, text, kind = "td") => row.appendChild(Object.assign(document.createElement(kind), { textContent: text }));

  const heading = (id, key) => Object.assign(document.getElementById(id), { href: items[key].href, textContent: items[key].title });

  // A row of two values: name, marks at percents of the width, text.
  const mark = (look, left, width) => {
    const found = Object.assign(document.createElement("i"), { className: look });
    found.style.left = `${left}%`;
    if (width !== undefined) found.style.width = `${width}%`;
    return found;
  };
  const line = (list, name, marks, text) => {
    const row = list.appendChild(document.createElement("li"));
    row.appendChild(Object.assign(document.createElement("span"), { textContent: name }));
    row.appendChild(document.createElement("b")).append(...marks);
    row.appendChild(Object.assign(document.createElement("small"), { textContent: text }));
  };
  const fill = (id, shown) => {
    const box = document.getElementById(id);
    box.hidden = !shown;
    const list = box.querySelector("ol");
    list.replaceChildren();
    return list;
  };

  // Errors on the same recordings, as multiples of the noise floor, else of the smaller one.
  const errors = (first, second) => {
    const where = first.errors.map(([place]) => place).find((place) => second.errors.some(([other]) => other === place));
    const pairs = first.errors.filter(([place]) => place === where).flatMap(([, name, value, floor, text]) => {
      const other = second.errors.find(([place, own]) => place === where && own === name);
      return other ? [{ name, values: [value, other[2]], floor, texts: [text, other[4]] }] : [];
    });
    const known = pairs.every(({ floor }) => floor);
    const list = fill("errors", pairs.length > 0);
    if (!pairs.length) return;
    const ratios = pairs.map(({ values, floor }) => values.map((value) => Math.max(value / (known ? floor : Math.min(...values)) || 1, 0.6)));
    const decades = Math.max(1, Math.ceil(Math.log10(Math.max(...ratios.flat()) * 1.05)));
    const x = (ratio) => (100 * (Math.log10(ratio) + 0.25)) / (decades + 0.25);
    pairs.forEach(({ name, texts }, i) => {
      const [left, right] = ratios[i].map(x);
      const ticks = Array.from({ length: decades + 1 }, (_, decade) => mark("tick", x(10 ** decade)));
      const bar = mark("bar", Math.min(left, right), Math.abs(right - left));
      line(list, name, [mark("noise", 0, x(1.5)), ...ticks, bar, mark("before", left), mark("after", right)], texts.join(" → "));
    });
    document.getElementById("where").textContent = where;
    document.getElementById("scale").textContent = known ? "lines at 1, 10, 100 … noise floors" : "lines at 1, 10, 100 … times the smaller one";
  };

  // Parameters of effects: values and intervals on the scale of each row.
  const parameters = (first, second) => {
    const sides = [first, second].map((item) => new Map(item.parameters.map(([name, ...own]) => [name, own])));
    const names = [...new Set(sides.flatMap((side) => [...side.keys()]))];
    const list = fill("parameters", names.length > 0);
    for (const name of names) {
      const own = sides.map((side) => side.get(name));
      const numbers = own.flatMap((side) => (side && side[0] !== null ? [0, side[0], ...(side[1] ?? [])] : []));
      const [low, high] = [Math.min(0, ...numbers), Math.max(0, ...numbers)];
      const x = (value) => (high > low ? (92 * (value - low)) / (high - low) : 0);
      const marks = [mark("tick", x(0))];
      own.forEach((side, i) => {
        if (!side || side[0] === null) return;
        if (side[1]) marks.push(mark("bar", x(side[1][0]), x(side[1][1]) - x(side[1][0])));
        marks.push(mark(i ? "after" : "before", x(side[0])));
      });
      const text = (side) => (side ? `${side[2]}${side[3] === "–" ? "" : ` (${side[3]})`}` : "none");
      line(list, name, marks, text(own[0]) === text(own[1]) ? text(own[0]) : own.map(text).join(" → "));
    }
  };

  const show = () => {
    body.replaceChildren();
    if (!items[a.value] || !items[b.value]) return;
    heading("head-a", a.value);
    heading("head-b", b.value);
    errors(items[a.value], items[b.value]);
    parameters(items[a.value], items[b.value]);
    for (const picture of document.querySelectorAll("figure.trace")) {
      picture.hidden = [a.value, b.value].sort().join() !== [picture.dataset.a, picture.dataset.b].sort().join();
    }
    const sides = [a, b].map((select) => new Map(items[select.value].facts.map(([group, name, text]) => [JSON.stringify([group, name]), text])));
    const places = [...new Set([...sides[0].keys(), ...sides[1].keys()])].map((place) => JSON.parse(place));
    const groups = [...new Set(places.map(([group]) => group))];
    let count = 0;
    for (const group of groups) {
      const rows = places.filter(([own]) => own === group).map((place) => {
        const texts = sides.map((side) => side.get(JSON.stringify(place)) ?? "–");
        return { name: place[1], texts, differs: texts[0] !== texts[1] };
      });
      count += rows.filter((row) => row.differs).length;
      const wanted = rows.filter((row) => row.differs || !different.checked);
      if (!wanted.length) continue;
      const title = body.insertRow();
      title.className = "group";
      cell(title, group, "th").colSpan = 3;
      for (const { name, texts, differs } of wanted) {
        const row = body.insertRow();
        row.className = differs && !different.checked ? "differs" : "";
        cell(row, name);
        texts.forEach((text) => cell(row, text));
      }
    }
    document.getElementById("result").textContent = count ? `All properties: ${count} differ` : "All properties: none differs";
    history.replaceState(null, "", `#a=${encodeURIComponent(a.value)}&b=${encodeURIComponent(b.value)}`);
  };

  const wanted = new URLSearchParams(location.hash.slice(1));
  const first = a.form.dataset;
  for (const select of [a, b]) select.value = items[wanted.get(select.id)] ? wanted.get(select.id) : first[select.id];
  for (const control of [a, b, different]) control.addEventListener("change", show);
  show();
})();

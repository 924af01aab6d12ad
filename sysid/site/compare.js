"use strict";
// The properties of two items side by side. The choice is kept in the address: #a=KEY&b=KEY.
(() => {
  const items = JSON.parse(document.getElementById("items").textContent);
  const [a, b, different] = ["a", "b", "different"].map((id) => document.getElementById(id));
  const body = document.getElementById("compared").tBodies[0];
  const cell = (row, text, kind = "td") => row.appendChild(Object.assign(document.createElement(kind), { textContent: text }));

  const heading = (id, key) => {
    const link = Object.assign(document.createElement("a"), { href: items[key].href, textContent: items[key].title });
    document.getElementById(id).replaceChildren(link);
  };

  const show = () => {
    body.replaceChildren();
    if (!items[a.value] || !items[b.value]) return;
    heading("head-a", a.value);
    heading("head-b", b.value);
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
    document.getElementById("result").textContent = count ? `${count} properties differ.` : "No property differs.";
    history.replaceState(null, "", `#a=${encodeURIComponent(a.value)}&b=${encodeURIComponent(b.value)}`);
  };

  const wanted = new URLSearchParams(location.hash.slice(1));
  for (const select of [a, b]) if (items[wanted.get(select.id)]) select.value = wanted.get(select.id);
  if (!wanted.get("b") && a.selectedOptions.length) {  // the next of the same kind, if there is one
    const own = [...a.selectedOptions[0].parentElement.children];
    b.value = (own[(own.indexOf(a.selectedOptions[0]) + 1) % own.length]).value;
  }
  for (const control of [a, b, different]) control.addEventListener("change", show);
  show();
})();

"use strict";
// Search, kinds, sorting and the choice of two rows on the page of the workspace.
(() => {
  const table = document.getElementById("table");
  const body = table.tBodies[0];
  const search = document.getElementById("search");
  const compare = document.getElementById("compare");
  const kinds = [...document.querySelectorAll("[data-kind][aria-pressed]")];
  const rows = [...body.rows];

  const filter = () => {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    const chosen = kinds.filter((button) => button.ariaPressed === "true").map((button) => button.dataset.kind);
    let shown = 0;
    for (const row of rows) {
      const wanted = (!chosen.length || chosen.includes(row.dataset.kind)) && words.every((word) => row.dataset.text.includes(word));
      row.hidden = !wanted;
      shown += wanted;
    }
    document.getElementById("none").hidden = shown > 0 || !rows.length;
  };
  search.addEventListener("input", filter);
  search.form.addEventListener("submit", (event) => event.preventDefault());
  for (const button of kinds) {
    button.addEventListener("click", () => { button.ariaPressed = String(button.ariaPressed !== "true"); filter(); });
  }

  const headers = [...table.tHead.rows[0].cells];
  const text = (row, column) => row.cells[column].dataset.sort ?? row.cells[column].textContent;
  headers.forEach((header, column) => header.querySelector("button")?.addEventListener("click", () => {
    const up = header.ariaSort !== "ascending";
    headers.filter((other) => other.ariaSort).forEach((other) => { other.ariaSort = "none"; });
    header.ariaSort = up ? "ascending" : "descending";
    const order = new Intl.Collator(undefined, { numeric: true });
    rows.sort((a, b) => (up ? 1 : -1) * order.compare(text(a, column), text(b, column)));
    body.append(...rows);
  }));

  const picked = [];
  body.addEventListener("change", ({ target }) => {
    if (target.type !== "checkbox") return;
    if (target.checked) picked.push(target); else picked.splice(picked.indexOf(target), 1);
    if (picked.length > 2) picked.shift().checked = false;
    const keys = picked.map((box) => encodeURIComponent(box.closest("tr").dataset.key));
    compare.href = keys.length === 2 ? `compare.html#a=${keys[0]}&b=${keys[1]}` : "compare.html";
    compare.textContent = ["Choose two rows to compare", "Choose one more row", "Compare them"][keys.length];
    compare.classList.toggle("ready", keys.length === 2);
  });
  filter();
})();

"use strict";
// Filters the rows of a table by the values of some columns and by words. The fragment
// of the address keeps the filters, so that a link can set them.
(() => {
  const state = new URLSearchParams(location.hash.slice(1));
  for (const table of document.querySelectorAll("table[data-filters]")) {
    const rows = [...table.tBodies[0].rows];
    const text = (row, column) => row.cells[column].textContent.trim();
    const bar = document.createElement("p");
    const count = document.createElement("span");
    const inputs = [];
    const add = (name, column, input) => {
      const label = document.createElement("label");
      input.value = state.get(name) ?? "";
      label.append(`${name} `, input);
      bar.append(label);
      inputs.push({ name, column, input });
      input.addEventListener("input", filter);
    };
    const filter = () => {
      const chosen = inputs.filter(({ input }) => input.value);
      const fits = ({ column, input }, row) => column < 0
        ? row.textContent.toLowerCase().includes(input.value.toLowerCase())
        : text(row, column) === input.value;
      for (const row of rows) row.hidden = !chosen.every((each) => fits(each, row));
      const shown = rows.filter((row) => !row.hidden).length;
      count.textContent = `${shown} of ${rows.length}`;
      const hash = new URLSearchParams(chosen.map((e) => [e.name, e.input.value]));
      history.replaceState(null, "", hash.size ? `#${hash}` : location.pathname + location.search);
    };
    bar.className = "filters";
    for (const column of table.dataset.filters.split(",").map(Number)) {
      const select = document.createElement("select");
      const values = new Set(rows.map((row) => text(row, column)));
      select.append(new Option("all", ""));
      for (const value of [...values].sort()) select.append(new Option(value, value));
      add(table.tHead.rows[0].cells[column].textContent.trim(), column, select);
    }
    const words = document.createElement("input");
    words.type = "search";
    add("Words", -1, words);
    bar.append(count);
    table.before(bar);
    filter();
  }
})();

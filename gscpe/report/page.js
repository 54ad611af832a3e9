// SPDX-License-Identifier: Apache-2.0
"use strict";

// Photo and render share a place; the range input over them moves the cut.
for (const box of document.querySelectorAll(".compare")) {
  const input = box.querySelector("input");
  const move = () => box.style.setProperty("--cut", `${input.value}%`);
  input.addEventListener("input", move);
  move();
}

// A click shows a small picture as large as it is; Escape or a click closes it.
const dialog = document.getElementById("enlarged");
for (const button of document.querySelectorAll(".enlarge")) {
  button.addEventListener("click", () => {
    const image = button.querySelector("img");
    dialog.querySelector("img").src = image.src;
    dialog.querySelector("img").alt = image.alt;
    dialog.querySelector("p").textContent = image.alt;
    dialog.showModal();
  });
}
dialog.addEventListener("click", () => dialog.close());

// Numbers sort as numbers, and cells without one come last, whichever way.
const number = (text) => (/^[-+]?[\d.]+(e[-+]?\d+)?$/i.test(text) ? parseFloat(text) : NaN);

function compare(a, b, numeric, direction) {
  if (!numeric) return direction * a.localeCompare(b, undefined, { numeric: true });
  const [x, y] = [number(a), number(b)];
  if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) - Number.isNaN(y);
  return direction * (x - y);
}

for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells];
  const body = table.tBodies[0];
  heads.forEach((head, column) => {
    head.querySelector("button").addEventListener("click", () => {
      const direction = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", direction > 0 ? "ascending" : "descending");
      const numeric = [...body.rows].some((r) => r.cells[column].classList.contains("number"));
      const rows = [...body.rows].map((row) => [row.cells[column].textContent.trim(), row]);
      rows.sort((a, b) => compare(a[0], b[0], numeric, direction));
      body.append(...rows.map((row) => row[1]));
    });
  });
}

const filter = document.getElementById("filter");
filter.addEventListener("input", () => {
  const wanted = filter.value.toLowerCase();
  for (const row of document.querySelectorAll("table.sortable tbody tr")) {
    row.hidden = !row.textContent.toLowerCase().includes(wanted);
  }
});

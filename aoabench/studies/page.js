"use strict";
// The front table: the rows that pass the three filters are shown; a click on a head sorts by its column.
const front = document.getElementById("front"), body = front.tBodies[0], rows = Array.from(body.rows);
const [study, verdict, kind, words] = ["by-study", "by-verdict", "by-class", "by-text"].map((id) => document.getElementById(id));
const texts = new Map(rows.map((row) => [row, row.textContent.toLowerCase()]));

function filter() {
  const wanted = words.value.toLowerCase().split(/\s+/);
  for (const row of rows) {
    const {study: name, verdict: word, class: group, counts} = row.dataset;
    const fits = kind.value === "counts" ? counts === "yes" : !kind.value || group === kind.value;
    row.hidden = !((!study.value || name === study.value) && (!verdict.value || word === verdict.value) && fits
      && wanted.every((word) => texts.get(row).includes(word)));
  }
  const shown = rows.filter((row) => !row.hidden).length;
  document.getElementById("shown").textContent = `${shown} of ${rows.length} shown`;
}

function key(row, column) {
  const cell = row.cells[column], text = cell.dataset.sort ?? cell.textContent.trim();
  const number = text === "" ? NaN : Number(text);
  return Number.isNaN(number) ? text : number;
}

function compare(a, b) { // numbers by value, then texts by alphabet; missing values come last
  const [m, n] = [typeof a, typeof b];
  if (m !== n) return m === "number" ? -1 : 1;
  return m === "number" ? a - b : (a === "") - (b === "") || a.localeCompare(b, "en", { numeric: true });
}

front.querySelectorAll("th button").forEach((button, column) => button.addEventListener("click", () => {
  const head = button.parentElement, up = head.getAttribute("aria-sort") !== "ascending";
  front.querySelectorAll("th").forEach((other) => other.setAttribute("aria-sort", "none"));
  head.setAttribute("aria-sort", up ? "ascending" : "descending");
  const order = rows.map((row) => [key(row, column), row]).sort((a, b) => (up ? 1 : -1) * compare(a[0], b[0]));
  body.append(...order.map((pair) => pair[1]));
}));

[study, verdict, kind, words].forEach((control) => control.addEventListener("input", filter));
filter();

// A link to a claim shows it, whatever the filters are, and opens its details.
function follow() {
  const row = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (!row || row.parentElement !== body) return;
  if (row.hidden) { for (const control of [study, verdict, kind, words]) control.value = ""; filter(); }
  row.querySelector("details").open = true;
  row.scrollIntoView();
}
addEventListener("hashchange", follow);
follow();

// Commands can be copied where the browser allows it; a click on one selects it everywhere.
document.querySelectorAll(".command").forEach((line) => {
  if (!navigator.clipboard) return;
  const button = line.appendChild(Object.assign(document.createElement("button"), { type: "button", textContent: "Copy" }));
  const show = (text) => { button.textContent = text; setTimeout(() => { button.textContent = "Copy"; }, 1500); };
  button.addEventListener("click", () => navigator.clipboard.writeText(line.querySelector("code").textContent).then(
    () => show("Copied"), () => show("Not allowed")));
});

// On paper everything is open.
addEventListener("beforeprint", () => document.querySelectorAll("details.print").forEach((one) => { one.open = true; }));

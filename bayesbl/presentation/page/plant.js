"use strict";
const body = document.querySelector("#joints tbody");
const rows = Array.from(body.rows);
const search = document.querySelector("#search");
const type = document.querySelector("#type");
const state = document.querySelector("#state");
const shown = document.querySelector("#shown");
const texts = rows.map(row => row.textContent.toLowerCase());
function filter() {
  const asked = search.value.toLowerCase().split(/\s+/).filter(Boolean);
  let count = 0;
  rows.forEach((row, i) => {
    const fits = asked.every(word => texts[i].includes(word))
      && (!type.value || row.dataset.type === type.value)
      && (!state.value || (state.value === "alarm" ? row.classList.contains("alarm")
        : row.dataset.state.startsWith(state.value)));
    row.hidden = !fits;
    count += fits;
  });
  shown.textContent = count + " of " + rows.length + " joints";
}
function sort(heading) {
  const column = heading.cellIndex;
  const falls = heading.getAttribute("aria-sort") === "ascending";
  document.querySelectorAll("#joints th").forEach(th => th.removeAttribute("aria-sort"));
  heading.setAttribute("aria-sort", falls ? "descending" : "ascending");
  const sign = falls ? -1 : 1;
  const numeric = heading.classList.contains("number");
  const keyed = rows.map(row => [row, row.cells[column].dataset.key]);
  keyed.sort((a, b) => {
    const [x, y] = [a[1], b[1]];
    return sign * (numeric ? Number(x) - Number(y) : x.localeCompare(y, undefined, { numeric: true }));
  });
  body.append(...keyed.map(pair => pair[0]));
}
document.querySelectorAll("#joints th button").forEach(button =>
  button.addEventListener("click", () => sort(button.closest("th"))));
[search, type, state].forEach(tool => ["input", "change"].forEach(event =>
  tool.addEventListener(event, filter)));
document.querySelector(".bar-of-tools").hidden = false;
// Coming back, a browser fills in what was asked for after this script has run.
window.addEventListener("pageshow", filter);

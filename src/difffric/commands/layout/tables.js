// Tables that a click on a heading, or Enter on it, sorts: up, down, and as they were.
const number = (text) => {
  const found = /^[<>≤≥≈±\s]*([+\-−]?(?:\d+\.?\d*|\.\d+)(?:[eE][+\-−]?\d+)?)/.exec(text.trim());
  return found ? Number(found[1].replaceAll("−", "-")) : NaN;
};
const says = (text) => !["", "–"].includes(text.trim());
const words = new Intl.Collator("en", { numeric: true });

/** -1, 0 or 1; what says nothing comes last, whichever way the rest goes. */
const compare = (a, b, numbers, way) => {
  if (!says(a) || !says(b)) return Number(says(b)) - Number(says(a));
  const [x, y] = [number(a), number(b)];
  if (!numbers) return way * words.compare(a, b);
  if (Number.isNaN(x) || Number.isNaN(y)) return Number(Number.isNaN(x)) - Number(Number.isNaN(y));
  return way * (x - y);
};

for (const table of document.querySelectorAll("table.sorts")) {
  const body = table.tBodies[0], given = [...body.rows], headings = [...table.tHead.rows[0].cells];
  headings.forEach((heading, column) => {
    heading.querySelector("button").addEventListener("click", () => {
      const next = { none: "ascending", ascending: "descending", descending: "none" }[heading.ariaSort ?? "none"];
      for (const one of headings) one.ariaSort = "none";
      heading.ariaSort = next;
      const text = (row) => row.cells[column].textContent, way = next === "ascending" ? 1 : -1;
      const numbers = heading.classList.contains("number");
      const rows = next === "none" ? given : [...given].sort((a, b) => compare(text(a), text(b), numbers, way));
      body.append(...rows);
    });
  });
}

const body = document.querySelector('#rows'), rows = [...body.rows];
document.querySelectorAll('th[data-sort]').forEach((head, column) => {
  let up = false;
  head.onclick = () => {
    up = !up;
    const value = row => {
      const cell = row.cells[column];
      return cell ? cell.dataset.value ?? cell.textContent : '';
    };
    const order = (a, b) => {
      const [x, y] = [value(a), value(b)], [m, n] = [parseFloat(x), parseFloat(y)];
      const by = isNaN(m) || isNaN(n) ? x.localeCompare(y) : m - n;
      return up ? by : -by;
    };
    body.append(...[...body.rows].sort(order));
  };
});
document.querySelector('#find').oninput = event => {
  const wanted = event.target.value.toLowerCase();
  rows.forEach(row => row.hidden = !row.textContent.toLowerCase().includes(wanted));
};

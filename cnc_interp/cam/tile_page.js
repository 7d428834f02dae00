// The map of heights in tiles. Millimetres across and up; rows run along u, columns along v.
'use strict';

const KINDS = ['lowest', 'highest', 'mean'];
const KEPT = 160; // decoded tiles that are kept in memory
const [ROWS, COLUMNS] = facts.shape;
const CELL = [facts.lengths[0] / Math.max(1, ROWS - 1), facts.lengths[1] / Math.max(1, COLUMNS - 1)];
const SIZE = [ROWS * CELL[0], COLUMNS * CELL[1]];
const canvas = document.getElementById('map');
const tiles = new Map(); // name -> {rows, columns, values: [Float32Array ...], image, look}
const loading = new Set();
const view = { x: 0, y: 0, scale: 1 }; // mm at the middle; device pixels per mm
let kind = 'far', top_ = facts.top, marked = null, pointed = null, pending = false;

// --- tiles -------------------------------------------------------------------------------------

async function addTile(name, rows, columns, text) {
  const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('deflate'));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const count = rows * columns, values = [];
  for (let at = 0; at < bytes.length; at += 3 * count) {
    const heights = new Float32Array(count);
    for (let i = 0; i < count; i++) {
      const whole = bytes[at + i] | bytes[at + count + i] << 8 | bytes[at + 2 * count + i] << 16;
      heights[i] = whole === 0 ? NaN : (whole - facts.zero) * facts.step;
    }
    values.push(heights);
  }
  tiles.set(name, { rows, columns, values, image: null, look: '' });
  loading.delete(name);
  draw();
}

function tileOf(level, row, column) {
  const name = `${level}/${row}_${column}`, tile = tiles.get(name);
  if (tile) {
    tiles.delete(name); // the tiles used last are at the end
    tiles.set(name, tile);
  } else if (!loading.has(name)) {
    loading.add(name);
    const script = document.createElement('script');
    script.src = `page/${name}.js`;
    // After an error it stays in `loading`, so that a missing file is requested only once.
    script.onload = script.onerror = () => script.remove();
    document.head.append(script);
  }
  return tile;
}

function forget() {
  for (const name of tiles.keys()) {
    if (tiles.size <= KEPT) return;
    tiles.delete(name);
  }
}

function heightOf(tile, i) {
  const v = tile.values;
  if (v.length === 1) return v[0][i];
  if (kind === 'far') return Math.abs(v[0][i]) > Math.abs(v[1][i]) ? v[0][i] : v[1][i];
  return v[KINDS.indexOf(kind)][i];
}

// --- colours -----------------------------------------------------------------------------------

const STOPS = facts.colours.map(([at, c]) =>
  [at, ...[1, 3, 5].map((i) => parseInt(c.slice(i, i + 2), 16))]);
const SHADES = new Uint32Array(1024);
for (let i = 0; i < 1024; i++) {
  const at = i / 1023;
  let k = 1;
  while (k < STOPS.length - 1 && STOPS[k][0] < at) k++;
  const [a, b] = [STOPS[k - 1], STOPS[k]], share = (at - a[0]) / (b[0] - a[0]);
  const [red, green, blue] = [1, 2, 3].map((c) => Math.round(a[c] + share * (b[c] - a[c])));
  SHADES[i] = (255 << 24 | blue << 16 | green << 8 | red) >>> 0;
}
const UNCUT = (255 << 24 | 0xbf << 16 | 0xb6 << 8 | 0xae) >>> 0;

function shade(height) {
  if (Number.isNaN(height)) return UNCUT;
  const at = Math.round((height / top_ + 1) * 511.5);
  return SHADES[Math.max(0, Math.min(1023, at))];
}

function imageOf(tile) {
  const look = `${kind} ${top_}`;
  if (tile.look === look) return tile.image;
  const image = tile.image ?? document.createElement('canvas');
  image.width = tile.rows;
  image.height = tile.columns;
  const pixels = new ImageData(tile.rows, tile.columns), colours = new Uint32Array(pixels.data.buffer);
  for (let row = 0; row < tile.rows; row++) {
    for (let column = 0; column < tile.columns; column++) {
      const up = tile.columns - 1 - column;
      colours[up * tile.rows + row] = shade(heightOf(tile, row * tile.columns + column));
    }
  }
  image.getContext('2d').putImageData(pixels, 0, 0);
  tile.image = image;
  tile.look = look;
  return image;
}

// --- drawing -----------------------------------------------------------------------------------

function draw() {
  if (pending) return;
  pending = true;
  requestAnimationFrame(() => { pending = false; drawNow(); });
}

const across = (x) => (x - view.x) * view.scale + canvas.width / 2;
const down = (y) => (view.y - y) * view.scale + canvas.height / 2;

function levelNow() {
  const pixels = view.scale * Math.max(...CELL);
  return Math.max(0, Math.min(facts.levels - 1, Math.ceil(-Math.log2(pixels) - 1e-6)));
}

function drawNow() {
  const brush = canvas.getContext('2d');
  brush.fillStyle = '#eceff2';
  brush.fillRect(0, 0, canvas.width, canvas.height);
  const level = levelNow();
  // Coarser tiles stand in for those that are still loading.
  for (let l = facts.levels - 1; l >= level; l--) drawLevel(brush, l, l === level);
  if (marked) drawMark(brush);
  drawLength(brush);
  forget();
  if (pointed) tell(...pointed); // the tile under the pointer may have arrived
}

function drawLength(brush) {
  const ratio = devicePixelRatio, rough = 110 * ratio / view.scale;
  const decade = 10 ** Math.floor(Math.log10(rough));
  const length = decade * [5, 2, 1].find((n) => n * decade <= rough);
  const long = length * view.scale, y = canvas.height - 14 * ratio, x = 14 * ratio;
  brush.fillStyle = 'rgba(255, 255, 255, 0.85)';
  brush.fillRect(x - 6 * ratio, y - 22 * ratio, Math.max(long, 150 * ratio) + 12 * ratio, 30 * ratio);
  words(brush, 12);
  brush.fillRect(x, y, long, 3 * ratio);
  brush.textAlign = 'left';
  brush.fillText(`${+length.toPrecision(1)} mm, u to the right, v up`, x, y - 6 * ratio);
}

function drawLevel(brush, level, wanted) {
  const wide = facts.tile * 2 ** level;
  const count = [Math.ceil(ROWS / wide), Math.ceil(COLUMNS / wide)];
  const middle = [view.x, view.y], half = [canvas.width, canvas.height].map((n) => n / 2 / view.scale);
  const first = [0, 1].map((k) => Math.max(0, Math.floor((middle[k] - half[k]) / CELL[k] / wide)));
  const last = [0, 1].map((k) => Math.min(count[k] - 1, Math.floor((middle[k] + half[k]) / CELL[k] / wide)));
  for (let row = first[0]; row <= last[0]; row++) {
    for (let column = first[1]; column <= last[1]; column++) {
      const known = tiles.get(`${level}/${row}_${column}`);
      const tile = wanted || level === facts.levels - 1 ? tileOf(level, row, column) : known;
      if (!tile) continue;
      const cell = 2 ** level, x0 = row * wide * CELL[0], y0 = column * wide * CELL[1];
      const x1 = x0 + tile.rows * cell * CELL[0], y1 = y0 + tile.columns * cell * CELL[1];
      const [left, right] = [across(x0), across(x1)].map(Math.round);
      const [high, low] = [down(y1), down(y0)].map(Math.round);
      brush.imageSmoothingEnabled = false;
      brush.drawImage(imageOf(tile), left, high, right - left, low - high);
    }
  }
}

function drawMark(brush) {
  const x = across((marked[0] + 0.5) * CELL[0]), y = down((marked[1] + 0.5) * CELL[1]);
  const radius = 14 * devicePixelRatio;
  for (const [width, colour] of [[4, 'white'], [2, '#22303c']]) {
    brush.lineWidth = width * devicePixelRatio;
    brush.strokeStyle = colour;
    brush.beginPath();
    brush.arc(x, y, radius, 0, 7);
    brush.stroke();
  }
}

function drawScale() {
  const bar = document.getElementById('scale'), brush = fitted(bar), ratio = devicePixelRatio;
  const high = 14 * ratio;
  for (let x = 0; x < bar.width; x++) {
    const c = SHADES[Math.round(x / (bar.width - 1) * 1023)];
    brush.fillStyle = `rgb(${c & 255},${c >> 8 & 255},${c >> 16 & 255})`;
    brush.fillRect(x, 0, 1, high);
  }
  labels(brush, bar.width, high + 14 * ratio, 8, (share) => (top_ * (2 * share - 1)).toPrecision(3));
}

function drawClasses() {
  const place = document.getElementById('classes'), brush = fitted(place), ratio = devicePixelRatio;
  const low = facts.classes[0][0], high = facts.classes.at(-1)[0] + facts.width;
  const bins = Math.max(1, Math.min(Math.round((high - low) / facts.width), Math.floor(place.width / 4)));
  const counts = new Array(bins).fill(0), wide = (high - low) / bins;
  for (const [from, count] of facts.classes) {
    counts[Math.min(bins - 1, Math.floor((from + facts.width / 2 - low) / wide))] += count;
  }
  const most = Math.log10(Math.max(...counts) + 1), floor = place.height - 20 * ratio;
  counts.forEach((count, k) => {
    const tall = Math.log10(count + 1) / most * (floor - 16 * ratio);
    brush.fillStyle = '#4f93c9';
    brush.fillRect(k / bins * place.width, floor - tall, Math.max(1, place.width / bins - 1), tall);
  });
  const line = (facts.scallop - low) / (high - low) * place.width;
  brush.setLineDash([5 * ratio, 4 * ratio]);
  brush.strokeStyle = '#c0392b';
  brush.lineWidth = ratio;
  brush.beginPath();
  brush.moveTo(line, 0);
  brush.lineTo(line, floor);
  brush.stroke();
  labels(brush, place.width, place.height - 5 * ratio, 6, (share) => (low + share * (high - low)).toFixed(2));
  brush.textAlign = 'right';
  brush.fillText(`most: ${Math.max(...counts).toLocaleString('en')} needles`, place.width, 12 * ratio);
}

function labels(brush, width, y, count, text) {
  words(brush, 12);
  for (let k = 0; k <= count; k++) {
    brush.textAlign = k === 0 ? 'left' : k === count ? 'right' : 'center';
    brush.fillText(text(k / count) + (k === count ? ' µm' : ''), k / count * width, y);
  }
}

function words(brush, size) {
  brush.fillStyle = '#22303c';
  brush.font = `${size * devicePixelRatio}px system-ui, sans-serif`;
}

function fitted(element) {
  element.width = Math.max(1, Math.round(element.clientWidth * devicePixelRatio));
  element.height = Math.max(1, Math.round(element.clientHeight * devicePixelRatio));
  return element.getContext('2d');
}

// --- what the user does ------------------------------------------------------------------------

const widest = () => 0.96 * Math.min(canvas.width / SIZE[0], canvas.height / SIZE[1]);
const closest = () => 40 * devicePixelRatio / Math.min(...CELL);

function showAll() {
  [view.x, view.y] = [SIZE[0] / 2, SIZE[1] / 2];
  view.scale = widest();
  marked = null;
  draw();
}

function zoom(factor, px = canvas.width / 2, py = canvas.height / 2) {
  const x = view.x + (px - canvas.width / 2) / view.scale;
  const y = view.y - (py - canvas.height / 2) / view.scale;
  view.scale = Math.max(0.5 * widest(), Math.min(closest(), view.scale * factor));
  view.x = x - (px - canvas.width / 2) / view.scale;
  view.y = y + (py - canvas.height / 2) / view.scale;
  keepInside();
}

function keepInside() {
  view.x = Math.max(0, Math.min(SIZE[0], view.x));
  view.y = Math.max(0, Math.min(SIZE[1], view.y));
  draw();
}

function goTo([row, column]) {
  marked = [row, column];
  [view.x, view.y] = [(row + 0.5) * CELL[0], (column + 0.5) * CELL[1]];
  view.scale = Math.min(closest(), Math.max(view.scale, 6 * devicePixelRatio / Math.min(...CELL)));
  draw();
}

function tell(px, py) {
  pointed = [px, py];
  const place = document.getElementById('place');
  const row = Math.floor((view.x + (px - canvas.width / 2) / view.scale) / CELL[0]);
  const column = Math.floor((view.y - (py - canvas.height / 2) / view.scale) / CELL[1]);
  if (row < 0 || column < 0 || row >= ROWS || column >= COLUMNS) {
    place.textContent = '';
    return;
  }
  const level = levelNow(), cell = 2 ** level;
  const [r, c] = [Math.floor(row / cell), Math.floor(column / cell)];
  const tile = tiles.get(`${level}/${Math.floor(r / facts.tile)}_${Math.floor(c / facts.tile)}`);
  const point = pointAt(row / Math.max(1, ROWS - 1), column / Math.max(1, COLUMNS - 1));
  let text = `x ${point.map((n) => n.toFixed(3)).join(', y ').replace(/, y ([^,]*)$/, ', z $1')} mm`;
  if (tile) {
    const i = r % facts.tile * tile.columns + c % facts.tile;
    const said = (n) => Number.isNaN(n) ? 'uncut' : `${n.toFixed(3)} µm`;
    text += tile.values.length === 1
      ? ` · needle ${row}, ${column}: ${said(tile.values[0][i])}`
      : ` · ${cell} × ${cell} needles: ` + KINDS.map((k, n) => `${k} ${said(tile.values[n][i])}`).join(', ');
  }
  place.textContent = text;
}

function pointAt(a, b) {
  const grid = facts.places, last = grid.length - 1;
  const [i, j] = [a, b].map((n) => Math.min(last - 1, Math.floor(n * last)));
  const [s, t] = [a * last - i, b * last - j];
  return [0, 1, 2].map((k) => (1 - s) * ((1 - t) * grid[i][j][k] + t * grid[i][j + 1][k])
    + s * ((1 - t) * grid[i + 1][j][k] + t * grid[i + 1][j + 1][k]));
}

const pointers = new Map();
const pixel = (event) => [event.offsetX * devicePixelRatio, event.offsetY * devicePixelRatio];
canvas.addEventListener('wheel', (event) => {
  event.preventDefault();
  zoom(Math.exp(-event.deltaY * (event.deltaMode === 1 ? 0.05 : 0.0016)), ...pixel(event));
}, { passive: false });
canvas.addEventListener('pointerdown', (event) => {
  canvas.setPointerCapture(event.pointerId);
  pointers.set(event.pointerId, pixel(event));
});
canvas.addEventListener('pointermove', (event) => {
  const now = pixel(event), before = pointers.get(event.pointerId);
  if (before) {
    const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
      zoom(apart(now) / Math.max(1, apart(before)), ...other);
    } else {
      view.x -= (now[0] - before[0]) / view.scale;
      view.y += (now[1] - before[1]) / view.scale;
      keepInside();
    }
    pointers.set(event.pointerId, now);
  }
  tell(...now);
});
for (const name of ['pointerup', 'pointercancel']) {
  canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
}
canvas.addEventListener('keydown', (event) => {
  const step = 0.15 * canvas.width / view.scale;
  const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
  if (event.key === '+' || event.key === '=') zoom(1.5);
  else if (event.key === '-') zoom(1 / 1.5);
  else if (event.key === '0') showAll();
  else if (moves[event.key]) {
    view.x += moves[event.key][0];
    view.y += moves[event.key][1];
    keepInside();
  } else return;
  event.preventDefault();
});
document.getElementById('kind').addEventListener('change', (event) => {
  kind = event.target.value;
  draw();
});
document.getElementById('top').value = top_;
document.getElementById('top').addEventListener('input', (event) => {
  const value = parseFloat(event.target.value);
  if (!(value > 0)) return;
  top_ = value;
  drawScale();
  draw();
});
document.getElementById('all').addEventListener('click', showAll);
document.getElementById('low').addEventListener('click', () => goTo(facts.lowest));
document.getElementById('high').addEventListener('click', () => goTo(facts.highest));
let fresh = true;
new ResizeObserver(() => {
  fitted(canvas);
  if (fresh) showAll();
  fresh = false;
  drawScale();
  drawClasses();
  draw();
}).observe(canvas);

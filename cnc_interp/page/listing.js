// The program text beside listing.py: only the lines in sight are made, however long it is.
window.listing = {
  ROW: 18, // height of a line [px]
  MOST: 1500000, // lines; a browser cannot lay out more
  AROUND: 8, // lines made above and below those in sight
  lines: [],
  number: 0,
  now: 0,
  wrong: [], // numbers of refused lines
  start: 0,
  picked: 0,
  follows: true,

  parts() {
    const box = document.querySelector('[data-mark="lines"]');
    return box ? [box, box.firstElementChild] : [];
  },
  async load(number) {
    this.number = number;
    const answer = number ? await fetch(`/program/${number}.txt`) : null;
    const text = answer?.ok ? await answer.text() : '';
    if (number !== this.number) return; // another one was loaded meanwhile
    this.lines = text ? text.split('\n').slice(0, this.MOST) : [];
    this.follows = true;
    const [box] = this.parts();
    if (!box) return;
    this.picked = 0;
    box.onscroll = () => this.draw();
    this.fitted ??= new ResizeObserver(() => this.go()); // turning a tablet loses the scroll position
    this.fitted.observe(box);
    box.onclick = (event) => this.pick(event.target.closest('li'));
    for (const kind of ['wheel', 'pointerdown', 'keydown']) box.addEventListener(kind, () => this.let_go());
    box.scrollTop = 0;
    this.go();
  },
  mark(now, wrong, start) {
    [this.now, this.wrong, this.start] = [now, wrong, start];
    this.go();
  },
  pick(row) {
    if (row) this.choose(Number(row.firstElementChild.textContent), false);
  },
  // Choose a line for the next start; scroll to it unless it was pressed here.
  choose(number, scrolls = true) {
    this.picked = number;
    emitEvent('pick_line', { line: number });
    const [box] = this.parts();
    if (scrolls) {
      this.follows = false;
      box.scrollTop = (number - 1) * this.ROW - 0.45 * box.clientHeight;
    }
    this.draw();
  },
  // The next line with the text after the picked one; after the last line the search restarts at the top.
  find(text) {
    const count = this.lines.length;
    const wanted = text.trim().toUpperCase();
    for (let k = 0; wanted && k < count; k++) {
      const at = (this.picked + k) % count;
      if (this.lines[at].toUpperCase().includes(wanted)) return this.choose(at + 1);
    }
    if (wanted) Quasar.Notify.create({ type: 'warning', message: `${wanted}: in no line of the program` });
  },
  let_go() {
    this.follows = false;
    this.say();
  },
  follow() {
    this.follows = true;
    this.go();
  },
  go() {
    const [box] = this.parts();
    const line = this.wrong[0] || this.now;
    if (box && this.follows && line) box.scrollTop = (line - 1) * this.ROW - 0.35 * box.clientHeight;
    this.draw();
  },
  say() {
    const key = document.querySelector('[data-mark="to the line"]');
    if (key) key.style.visibility = this.follows || !(this.wrong[0] || this.now) ? 'hidden' : '';
  },
  draw() {
    const [box, list] = this.parts();
    if (!box) return;
    const count = this.lines.length;
    const first = Math.max(0, Math.min(count, Math.floor(box.scrollTop / this.ROW)) - this.AROUND);
    const last = Math.min(count, first + Math.ceil(box.clientHeight / this.ROW) + 2 * this.AROUND);
    list.style.paddingTop = `${first * this.ROW}px`;
    list.style.paddingBottom = `${(count - last) * this.ROW}px`;
    list.replaceChildren(...this.lines.slice(first, last).map((text, k) => this.row(first + k + 1, text)));
    this.say();
  },
  row(number, text) {
    const row = document.createElement('li');
    const label = document.createElement('i');
    label.textContent = number;
    row.append(label, text);
    for (const kind of ['picked', 'start', 'now']) if (number === this[kind]) row.className = kind;
    if (this.wrong.includes(number)) row.className = 'wrong';
    return row;
  },
};

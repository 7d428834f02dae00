// The editor of program_dialogs.py: a text with numbered lines, the refused ones in red.
window.editor = {
  wrong: new Set(),

  parts() {
    const text = document.querySelector('[data-mark="edited text"]');
    return text ? [text, text.previousElementSibling] : [];
  },
  async open(number) {
    const answer = number ? await fetch(`/program/${number}.txt`) : null;
    const content = answer?.ok ? await answer.text() : '';
    const fill = () => {
      const [text] = this.parts();
      if (!text) return setTimeout(fill, 50); // the dialog is just opening
      text.value = content;
      text.oninput = () => this.draw();
      text.onscroll = () => this.draw();
      this.draw();
    };
    fill();
  },
  mark(lines) {
    this.wrong = new Set(lines);
    const [text] = this.parts();
    if (!text) return;
    if (lines.length) text.scrollTop = Math.max(0, (lines[0] - 4) * 18);
    this.draw();
  },
  draw() {
    const [text, list] = this.parts();
    const count = text.value.split('\n').length;
    const first = Math.floor(text.scrollTop / 18);
    const last = Math.min(count, first + Math.ceil(text.clientHeight / 18) + 1);
    list.style.marginTop = `${first * 18 - text.scrollTop}px`;
    list.replaceChildren(...Array.from({ length: last - first }, (_, k) => {
      const row = document.createElement('li');
      row.textContent = first + k + 1;
      if (this.wrong.has(first + k + 1)) row.className = 'wrong';
      return row;
    }));
  },
  give(kind) {
    const name = document.querySelector('[data-mark="edited name"]').value;
    emitEvent('edited', { kind, name, text: this.parts()[0].value });
  },
};

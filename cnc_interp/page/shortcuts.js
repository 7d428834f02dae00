// Keys of the keyboard that press a key of the page: what KEYBOARD in dialogs.py lists. Space and Enter never press one that moves
// the machine or changes an offset, and no key of the page keeps the focus after a pointer has pressed it.
window.keyboard = {
  names: MARKS,
  typing: (element) => element.closest('input, textarea, select, [contenteditable], .q-dialog'),
  reach(mark) {
    const field = document.querySelector(`input[data-mark="${mark}"], [data-mark="${mark}"] input`);
    field.scrollIntoView({ block: 'center' });
    field.focus({ preventScroll: true });
  },
  press(event) {
    const space = event.key === ' ' || event.key === 'Enter';
    if (space && event.target.closest?.('.moves, .changes')) {
      event.preventDefault();
      event.stopImmediatePropagation();
      return;
    }
    if (event.type !== 'keydown' || event.repeat || event.ctrlKey || event.metaKey || event.altKey) return;
    const mark = this.names[event.key];
    // A stop works everywhere, even while the user types.
    if (!mark || (this.typing(event.target) && event.key.length === 1)) return;
    event.preventDefault();
    document.querySelector(`[data-mark="${mark}"]:not([disabled])`)?.click();
  },
};
for (const kind of ['keydown', 'keyup', 'keypress'])
  document.addEventListener(kind, (event) => window.keyboard.press(event), true);
document.addEventListener('mousedown', (event) => {
  if (!event.target.closest?.('button')) return;
  event.preventDefault();
  document.activeElement?.blur();
}, true);

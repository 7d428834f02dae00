// The texts that stand in the fields of this page, by their marks.
window.shown = () => {
  const texts = {};
  for (const field of document.querySelectorAll('input[data-mark], [data-mark] input'))
    texts[field.closest('[data-mark]').dataset.mark] = field.value;
  return texts;
};

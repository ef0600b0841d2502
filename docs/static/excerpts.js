// Sphinx's search fetches the pages that it found for their excerpts. Browsers fetch nothing from a disk, so the texts
// come from texts.js.
window.fetch = async (address) => {
  const page = decodeURI(address).replace(document.documentElement.dataset.content_root, "").replace(/\.html$/, "");
  return { text: async () => `<div role="main">${TEXTS[page] ?? ""}</div>` };
};

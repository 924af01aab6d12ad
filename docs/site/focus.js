// What scrolls sideways can be reached with the keyboard; the theme wraps tables when the page is loaded.
const reach = () => {
  for (const region of document.querySelectorAll(".md-typeset__scrollwrap, .formula")) {
    if (region.scrollWidth > region.clientWidth) {
      region.tabIndex = 0
      region.setAttribute("role", "group")
      region.setAttribute("aria-label", region.matches(".formula") ? "Formula" : "Table")
    }
  }
}
addEventListener("load", () => new ResizeObserver(reach).observe(document.body))

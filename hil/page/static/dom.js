// Elements without markup in strings: whatever a text says, it stays a text.

export const byId = (id) => document.getElementById(id);

/** An element. properties: set on it; those with a dash are attributes. children: elements or texts. */
export function el(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.includes("-") || name === "role") made.setAttribute(name, value);
    else if (name === "data") Object.assign(made.dataset, value);
    else made[name] = value;
  }
  made.append(...children);
  return made;
}

/** Set a text only where it differs, so that nothing is laid out again for nothing. */
export function say(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/** The colours of the scheme in force, as a canvas takes them. */
export function palette() {
  const probe = palette.probe ??= document.body.appendChild(el("i", { hidden: false, "aria-hidden": "true" }));
  const read = (name) => {
    probe.style.color = `var(${name})`;
    return getComputedStyle(probe).color;
  };
  const names = ["--ink", "--faint", "--rule", "--a", "--b", "--c", "--d", "--red", "--card"];
  return Object.fromEntries(names.map((name) => [name.slice(2), read(name)]));
}

/** Small pieces of the page: elements are made, never written as HTML, so that no name of a file becomes markup. */

type Child = Node | string | null | undefined | false;
type Listener = (event: Event) => void;
type Properties = Record<string, string | number | boolean | null | undefined | Listener>;

/** Make an element. A property that is a function listens to the event of that name; true and false set or leave out. */
export function el<Name extends keyof HTMLElementTagNameMap>(
  name: Name,
  properties: Properties = {},
  ...children: Child[]
): HTMLElementTagNameMap[Name] {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(properties)) {
    if (typeof value === "function") element.addEventListener(key, value);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(key, String(value));
  }
  element.append(...kept(children));
  return element;
}

/** Put other children in the place of those that are there. */
export function fill(element: Element, ...children: Child[]): void {
  element.replaceChildren(...kept(children));
}

/** A button that cannot be pressed again while what it does goes on. */
export function button(text: string, press: () => void | Promise<void>, properties: Properties = {}): HTMLButtonElement {
  const element = el(
    "button",
    {
      type: "button",
      ...properties,
      click: () => {
        const done = press();
        if (!(done instanceof Promise)) return;
        element.disabled = true;
        void done.finally(() => {
          element.disabled = false;
        });
      },
    },
    text,
  );
  return element;
}

function kept(children: Child[]): (Node | string)[] {
  return children.filter((child): child is Node | string => child !== null && child !== undefined && child !== false);
}

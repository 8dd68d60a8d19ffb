/** Dark, light, or as the system has it. */

import { words } from "../words";

const CHOICES = ["system", "dark", "light"] as const;
type Choice = (typeof CHOICES)[number];

function stored(): Choice {
  try {
    const found = localStorage.getItem("theme") as Choice;
    return CHOICES.includes(found) ? found : "system";
  } catch {
    return "system"; // a page from disk may have no storage
  }
}

export function theme(button: HTMLButtonElement, changed: () => void): void {
  let choice = stored();
  const apply = () => {
    if (choice === "system") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = choice;
    const next = CHOICES[(CHOICES.indexOf(choice) + 1) % CHOICES.length];
    button.textContent = choice === "system" ? "◐" : choice === "dark" ? "●" : "○";
    button.setAttribute("aria-label", `${words.theme[choice]}; ${words.theme.change(next)}`);
    button.title = words.theme[choice];
    changed();
  };
  button.addEventListener("click", () => {
    choice = CHOICES[(CHOICES.indexOf(choice) + 1) % CHOICES.length];
    try {
      localStorage.setItem("theme", choice);
    } catch {
      // The choice then holds until the page is closed.
    }
    apply();
  });
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);
  apply();
}

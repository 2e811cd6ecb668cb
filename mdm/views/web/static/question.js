// A question before a command. It takes the focus, wherever the page is scrolled to, and gives it back.
import { html, useEffect, useRef } from "./vendor/htm-preact.js";

export function Question({ text, yes, answer }) {
  const box = useRef(null);
  useEffect(() => {
    const dialog = box.current, before = document.activeElement;
    dialog.showModal();
    dialog.querySelector(".no").focus();
    return () => { dialog.close(); before?.focus({ preventScroll: true }); };
  }, []);
  return html`<dialog class="ask" role="alertdialog" aria-label="Are you sure?" aria-describedby="question" ref=${box}
      onCancel=${(event) => { event.preventDefault(); answer(false); }}>
    <p id="question"><b>${text}</b></p>
    <div class="commands"><button class="danger" onClick=${() => answer(true)}>${yes}</button><button class="no" onClick=${() => answer(false)}>No</button></div></dialog>`;
}

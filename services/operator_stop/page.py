"""The page: one button, and a line that says what became of it. It fetches nothing but from where it came."""

PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Stop</title>
<style>
 html, body { margin: 0; height: 100%; font: 13px system-ui, sans-serif; background: transparent }
 button { width: 100%; height: 62px; border: 0; border-radius: 8px; background: #c9211e; color: white;
          font: bold 28px system-ui, sans-serif; letter-spacing: 0.2em; cursor: pointer }
 button:active { background: #8d1714 }
 p { margin: 4px 2px; min-height: 1.3em; color: #444 }
 p.bad { color: #c9211e; font-weight: bold }
</style>
<button id="stop">STOP</button><p id="said" role="status"></p>
<script>
 const said = document.getElementById("said");
 const tell = (text, bad) => { said.textContent = text; said.className = bad ? "bad" : "" };
 document.getElementById("stop").addEventListener("pointerdown", async () => {
   tell("stopping ...", false);
   try {
     const answer = await fetch("/stop", { method: "POST" });
     const words = await answer.text();
     tell(words, !answer.ok);
   } catch (error) { tell("the stop was not reached: use the robot's own, or `valorctl stop`", true) }
 });
 setInterval(async () => {
   try { await fetch("/", { method: "HEAD" }); if (said.className === "bad lost") tell("", false) }
   catch (error) { tell("this button reaches nobody", true); said.className = "bad lost" }
 }, 2000);
</script>
</html>
"""

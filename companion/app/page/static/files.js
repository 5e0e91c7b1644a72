// The flights' logs to download, and the settings to read. Settings are changed in their file alone.

const at = (id) => document.getElementById(id);

async function get(path, token) {
  const answer = await fetch(path, { headers: token ? { Authorization: `Bearer ${token}` } : {} });
  if (!answer.ok) throw new Error((await answer.text()).trim() || `error ${answer.status}`);
  return answer;
}

export async function showFlights(token) {
  try {
    const flights = await (await get("/flights", token)).json();
    at("flights").replaceChildren(...flights.map(({ name, megabytes }) => {
      const row = document.createElement("li"), button = document.createElement("button");
      button.type = "button";
      button.textContent = `${name}.zip, ${megabytes.toFixed(1)} MB`;
      button.onclick = () => download(name, token, button);
      row.append(button);
      return row;
    }));
    at("files-words").textContent = flights.length ? "" : "no flights yet";
  } catch (error) { at("files-words").textContent = error.message; }
}

export async function showSettings(token) {
  try { at("settings").textContent = await (await get("/settings", token)).text(); } catch (error) { at("settings").textContent = error.message; }
}

async function download(name, token, button) {
  button.disabled = true;
  try {
    const url = URL.createObjectURL(await (await get(`/flights/${name}`, token)).blob());
    const link = document.createElement("a");
    link.href = url;
    link.download = `${name}.zip`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(url), 60000);
    at("files-words").textContent = "";
  } catch (error) { at("files-words").textContent = `${name}: ${error.message}`; }
  button.disabled = false;
}

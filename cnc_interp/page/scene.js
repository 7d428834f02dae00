// For scene.py: the executed part of the path in a colour of its own, and what is seen through the machine.
window.scene = {
  async show_through(scene, names) {
    const objects = getElement(scene).objects;
    for (const object of names.map((name) => objects.get(name))) {
      await object?.ready_promise;
      if (!object?.mesh) continue;
      object.mesh.material.depthTest = false;
      object.mesh.material.transparent = true; // these are drawn last
      object.mesh.renderOrder = 1;
    }
  },
  show_done(scene, path, colour, corners) {
    getElement(scene).objects.get(path)?.mesh?.traverse((part) => {
      if (!part.isMesh) return;
      if (!Array.isArray(part.material)) {
        const done = part.material.clone();
        done.vertexColors = false;
        done.color.set(colour);
        part.material = [done, part.material];
      }
      part.geometry.clearGroups();
      part.geometry.addGroup(0, corners, 0);
      part.geometry.addGroup(corners, Infinity, 1);
    });
  },
};

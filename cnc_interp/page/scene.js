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
  NEAR: 14, // distance from the pointer within which a point of the path is picked [px]
  // A press beside the path picks the point of it that is nearest on the screen.
  pickable(scene, path, sides) {
    const view = getElement(scene);
    const canvas = view.renderer.domElement;
    let down = null;
    canvas.onpointerdown = (event) => (down = [event.clientX, event.clientY]);
    canvas.onclick = (event) => {
      if (!down || Math.hypot(event.clientX - down[0], event.clientY - down[1]) > 4) return; // it was turned
      const box = canvas.getBoundingClientRect();
      let best = this.NEAR;
      let point = -1;
      view.objects.get(path)?.mesh?.traverse((part) => {
        if (!part.isMesh) return;
        const vertices = part.geometry.attributes.position;
        const place = part.position.clone();
        for (let i = 0; i < vertices.count; i += sides) {
          place.fromBufferAttribute(vertices, i).applyMatrix4(part.matrixWorld).project(view.camera);
          const x = box.left + (0.5 + place.x / 2) * box.width - event.clientX;
          const y = box.top + (0.5 - place.y / 2) * box.height - event.clientY;
          if (Math.hypot(x, y) < best) [best, point] = [Math.hypot(x, y), i / sides];
        }
      });
      if (point >= 0) emitEvent('pick_point', { point });
    };
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

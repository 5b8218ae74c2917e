// CiA 402 drives that are not ours: the npm package `canopen` as device, and the power state machine that it lacks.
// node npm_drive.js EDS NODE ...: a drive a node, each on the file EDS.NODE. Frames come and go as lines of JSON,
// {"id": 1411, "data": "4b..."}; {"order": "fault", "node": 3} lets a drive fail; {"node": 3, "state": "switched on"} is
// each new state, {"node": 3, "torque": 250} each new torque (6071h, thousandths) of a drive that is enabled.
const readline = require('readline');
const { Device } = require('canopen');

const say = (object) => process.stdout.write(JSON.stringify(object) + '\n');
const STATES = { // statusword, and what leads on by the lowest four bits of the controlword
    'switch on disabled': [0x40, { 6: 'ready to switch on' }],
    'ready to switch on': [0x21, { 7: 'switched on', 15: 'switched on' }],
    'switched on': [0x23, { 6: 'ready to switch on', 15: 'operation enabled' }],
    'operation enabled': [0x27, { 6: 'ready to switch on', 7: 'switched on' }],
    'fault': [0x08, {}],
};

class Drive {
    constructor(file, node) {
        this.node = node;
        this.device = new Device({ id: node, eds: file });
        this.device.addListener('message', ({ id, data }) => say({ id, data: Buffer.from(data).toString('hex') }));
        this.device.nmt.addListener('reset', () => this.enter('switch on disabled'));
        this.device.nmt.addListener('timeout', () => this.fail(0x8130));
        this.device.sync.addListener('sync', () => this.onSync());
        this.torque = this.word = 0;
        this.enter('switch on disabled');
        this.device.start();
    }

    enter(state) {
        if (state !== this.state)
            say({ node: this.node, state });
        this.state = state;
        this.device.setValue(0x6041, STATES[state][0]);
    }

    fail(code) {
        this.enter('fault');
        this.device.emcy.write(code, Buffer.alloc(5)); // given one object, it sends code 0
    }

    onSync() { // the PDO that came before it is in the dictionary
        const before = this.word, word = this.word = this.device.getValue(0x6040);
        this.device.setValue(0x6061, this.device.getValue(0x6060));
        const next = STATES[this.state][1][word & 0xf];
        if (this.state === 'fault') {
            if (word & ~before & 0x80)
                this.enter('switch on disabled');
        }
        else if (!(word & 2)) {
            this.enter('switch on disabled');
        }
        else if (next) {
            this.enter(next);
        }
        const enabled = this.state === 'operation enabled' && this.device.getValue(0x6061) === 10;
        const torque = enabled ? this.device.getValue(0x6071) : 0;
        if (torque !== this.torque)
            say({ node: this.node, torque });
        this.torque = torque;
    }
}

const [file, ...nodes] = process.argv.slice(2);
const drives = nodes.map((node) => new Drive(`${file}.${node}`, Number(node)));
readline.createInterface({ input: process.stdin }).on('line', (line) => {
    const { order, node, id, data } = JSON.parse(line);
    if (order) {
        drives.find((drive) => drive.node === node).fail(0x2310);
        return;
    }
    const bytes = Buffer.from(data, 'hex');
    for (const drive of drives)
        drive.device.receive({ id, data: bytes, len: bytes.length });
}).on('close', () => process.exit(0));

"use strict";(()=>{var u=c=>document.getElementById(c);function L(c,t){c.textContent!==t&&(c.textContent=t)}function $(c,t){return(Math.abs(c)<.5*10**-t?0:c).toFixed(t).
replace("-","−")}var A=(c,t)=>u(c).setAttribute("aria-pressed",String(t));function dt(c){let t="http://www.w3.org/2000/svg",s=document.createElementNS(
t,"svg"),e=document.createElementNS(t,"path");return s.setAttribute("viewBox","0 0 16 16"),s.setAttribute("aria-hidden","true"),e.setAttribute("d",c),
s.append(e),s}function P(c){let t=p("i","swatch");return t.style.background=c,t}var T=c=>p("i",`letter of-${c}`,c);function p(c,t="",s="",e=[]){let i=document.
createElement(c);return t&&(i.className=t),s&&(i.textContent=s),i.append(...e),i}function C(c,t,s){let e=p("button",c,"",t);return e.type="button",e.addEventListener(
"click",s),e}function q(c,t){let s=t.findIndex(i=>i===document.activeElement),e={ArrowDown:s+1,ArrowUp:s-1,Home:0,End:t.length-1}[c.key];e===void 0||s<
0||(c.preventDefault(),c.stopPropagation(),t[e]?.focus())}function Yt(c,[t,s,e,i,n]){let o=new Int32Array(s);for(let a=0;a<e;a++){let r=t+a*s;for(let h=0;h<s;h++)o[h]|=c[r+h]<<8*a}for(let a=0;a<s;a++)o[a]=o[a]>>>
1^-(o[a]&1);for(let a=0;a<n;a++){let r=0;for(let h=0;h<s;h++)o[h]=r=r+o[h]|0}return i===1?o:Float64Array.from(o,a=>a*i)}function mt(c){let t=atob(c),s=new Uint8Array(
t.length);for(let e=0;e<t.length;e++)s[e]=t.charCodeAt(e);return s}async function ft(c){let t=new Blob([mt(c)]).stream().pipeThrough(new DecompressionStream(
"deflate")),s=await new Response(t).arrayBuffer(),e=new DataView(s).getUint32(0,!0),i=new TextDecoder().decode(new Uint8Array(s,4,e)),n=new Uint8Array(
s,4+e);return JSON.parse(i,(o,a)=>a&&a.column?Yt(n,a.column):a)}function b(c,t){let s=0,e=c.length;for(;s<e;){let i=s+e>>1;c[i]<=t?s=i+1:e=i}return s}var Zt=["acceleration","gap","ttc","throttle","brake","steer","light","distance"],_=class{constructor(t,s){this.tracks=t,this.measured=new Map(s.map(e=>[
e.id,e])),this.known=new Map}series(t){let s=this.known.get(t)??this.measure(t);return this.known.set(t,s),s}measure(t){let{times:s}=this.tracks,e=this.
measured.get(this.tracks.actors[t].id),i=Float64Array.from(s,(r,h)=>this.tracks.speedAt(t,h)),n=Uint8Array.from(s,(r,h)=>this.tracks.trackAt(t,h)<0?0:
1),o={speed:i};for(let r of Zt){let h=e?.[r];o[r]=Float64Array.from(s,(l,d)=>h&&n[d]&&h[d]>-127?h[d]:NaN)}let a=Int32Array.from(s,(r,h)=>e&&o.gap[h]>=
0?this.tracks.indexOf(e.leader[h],r):-1);return{times:s,values:o,leader:a,isMeasured:e!==void 0}}};var At=2*Math.PI/16384,V=class{constructor(t){this.times=t.times,this.spans=t.spans,this.starts=this.spans.map(([a])=>a),this.ends=new Set(this.starts.
map(a=>b(this.times,a-1e-4)-1)),this.actors=t.actors,this.x=t.x,this.y=t.y,this.yaw=t.yaw,this.speeds=t.speed;let[s,e,i,n,o]=t.tracks;this.first=e,this.
last=i,this.begin=n,this.count=o,this.own=this.actors.map(()=>[]),s.forEach((a,r)=>this.own[a].push(r)),this.firsts=this.own.map(a=>a.map(r=>this.first[r])),
this.byId=new Map,this.actors.forEach(({id:a,since:r},h)=>{let l=this.byId.get(a)??{indices:[],since:[]};this.byId.set(a,l),l.indices.push(h),l.since.
push(r??0)}),this.lights=ut(t.lights),this.falls=ut(t.lying),this.lamps=ut(t.lamps),this.marks=t.marks,this.marked=this.marks.map(([a])=>a)}lightState(t,s){
return pt(this.lights.get(t),s)}lying(t,s){let e=pt(this.falls.get(t),s);return e===null||e<0?null:e*Math.PI/180}lampsOf(t,s){return pt(this.lamps.get(
t),s)??0}marksAt(t){return this.marks[b(this.marked,t+1e-4)-1]?.[1]??[]}covers(t){let s=this.spans[b(this.starts,t)-1];return s!==void 0&&t<=s[1]}sampleAt(t){
return Math.max(0,b(this.times,t+1e-5)-1)}pose(t,s,e,i){let{until:n}=this.actors[t];if(n!==null&&n<=s)return!1;let o=this.trackAt(t,e);if(o<0)return!1;
let a=this.row(o,e);if(i.x=this.x[a],i.y=this.y[a],i.yaw=this.yaw[a]*At,this.count[o]>1&&e<this.last[o]){let r=Math.max(0,s-this.times[e])/(this.times[e+
1]-this.times[e]);i.x+=r*(this.x[a+1]-i.x),i.y+=r*(this.y[a+1]-i.y),i.yaw+=r*(this.yaw[a+1]-this.yaw[a])*At}return!0}trackAt(t,s){let e=this.own[t][b(
this.firsts[t],s)-1];return e!==void 0&&this.last[e]>=s?e:-1}row(t,s){return this.begin[t]+(this.count[t]===1?0:s-this.first[t])}speedAt(t,s){let e=this.
trackAt(t,s),i=e<0?-1:this.speeds[this.row(e,s)];return i<0?NaN:i}speed(t,s){return this.speedAt(t,this.sampleAt(s))}path(t,s,e){let[i,n]=[this.sampleAt(
s),this.sampleAt(e)],o=[],a=-1;for(let r of this.own[t]){let[h,l]=[this.first[r],this.last[r]];if(l>=i&&h<=n){(h!==a||!o.length)&&o.push([]);for(let d=Math.
max(i,h);d<=Math.min(n,l);d++){let[m,f]=[o[o.length-1],this.row(r,d)];(this.x[f]!==m[m.length-2]||this.y[f]!==m[m.length-1])&&m.push(this.x[f],this.y[f])}}
a=l}return o}continues(t){return t+1<this.times.length&&!this.ends.has(t)}indexOf(t,s){let e=this.byId.get(t??-1);return e?e.indices[Math.max(0,b(e.since,
s+1e-4)-1)]:-1}};function ut({actor:c,time:t,value:s}){let e=new Map;return c.forEach((i,n)=>{let o=e.get(i)??{times:[],values:[]};e.set(i,o),o.times.
push(t[n]),o.values.push(s[n])}),e}function pt(c,t){let s=c?b(c.times,t+1e-4):0;return c&&s?c.values[s-1]:null}var Y=.5,Et=.15,Tt=["other","sensor","traffic sign","traffic light","walker","vehicle"],B=({kind:c})=>c==="vehicle"||c==="walker",z=({kind:c,hero:t})=>Tt.
indexOf(c)+(t?Tt.length:0),J=class{constructor(t,s,e){this.index=t,this.letter="AB"[t],this.report=s,this.tracks=new V(e),this.motion=new _(this.tracks,
e.measured);let{actors:i}=this.tracks;this.order=i.map((o,a)=>a).sort((o,a)=>z(i[o])-z(i[a])),this.twins=new Map;let n=s.incidents.flatMap(o=>o.start===
null?[]:[{incident:o,start:o.start}]);this.timed=n.sort((o,a)=>o.start-a.start),this.starts=this.timed.map(({start:o})=>o)}incidentsIn(t,s){return this.
timed.slice(b(this.starts,t),b(this.starts,s))}actor(t,s){return this.tracks.actors[this.tracks.indexOf(t,s)]??null}poseOf(t,s){let[e,i]=[{x:0,y:0,yaw:0},
this.tracks.indexOf(t,s)];return i>=0&&this.tracks.pose(i,s,this.tracks.sampleAt(s),e)?e:null}twin(t){return this.twins.get(t)??-1}has({kind:t,start:s,
types:e}){return this.incidentsIn((s??NaN)-1,(s??NaN)+1).some(({incident:n})=>n.kind===t&&n.types.join()===e.join())}};function Lt(c,t){for(let[s,e,i,
n]of c.report.differences?.pairs??[]){let[o,a]=[c.tracks.indexOf(s,e??0),t.tracks.indexOf(i,n??0)];o<0||a<0||t.twins.has(a)||(c.twins.set(o,a),t.twins.
set(a,o))}}var gt=200,Z=class{constructor(t,s,e){this.choose=s,this.changed=e,this.search=u("search"),this.list=u("actor-list"),this.panels=[u("incidents-panel"),
u("actors-panel")],this.entries=t.flatMap(i=>{let{actors:n,own:o}=i.tracks,a=h=>!i.index||B(n[h])&&i.twin(h)<0,r=i.order.filter(h=>o[h].length&&n[h].kind!==
"sensor"&&a(h));return r.sort((h,l)=>z(n[l])-z(n[h])||h-l),r.map(h=>this.entry(i,h,t.length>1))}),this.shown=[],this.search.addEventListener("input",()=>this.
find()),this.search.addEventListener("keydown",i=>this.key(i)),this.list.addEventListener("keydown",i=>q(i,this.shown.map(({button:n})=>n))),["inciden\
ts-tab","actors-tab"].forEach((i,n)=>u(i).addEventListener("click",()=>this.open(n===1))),u("actors-count").textContent=String(this.entries.length),this.
find()}entry(t,s,e){let{id:i,type:n,kind:o,label:a,role:r,color:h}=t.tracks.actors[s],l=[...e?[T(t.letter)]:[],P(h),p("span","",a),p("small","",n||o)],
d=C("actor",l,()=>this.choose(t,s));return d.title=`Follow ${a}`,{recording:t,actor:s,button:d,words:`${a} ${n} ${o} ${r} ${i}`.toLowerCase()}}get isOpen(){
return!this.panels[1].hidden}open(t){this.panels.forEach((s,e)=>s.hidden=t!==(e===1)),A("actors-tab",t),A("incidents-tab",!t),this.changed()}startSearch(){
this.open(!0),this.search.focus(),this.search.select()}find(){let t=this.search.value.toLowerCase().split(/\s+/),s=this.entries.filter(i=>t.every(n=>i.
words.includes(n)));this.shown=s.slice(0,gt),this.list.replaceChildren(...this.shown.map(({button:i})=>p("li","","",[i])));let e=s.length>gt?`and ${s.
length-gt} more`:"";u("actors-note").textContent=s.length?e:"No actor is found.",this.changed()}key(t){if(t.stopPropagation(),t.key==="ArrowDown")this.
shown[0]?.button.focus();else if(t.key==="Enter")this.shown[0]?.button.click();else if(t.key==="Escape"&&this.search.value)this.search.value="";else if(t.
key==="Escape")this.open(!1),u("incidents-tab").focus();else return;t.preventDefault(),t.key==="Escape"&&this.find()}show(t,s){if(this.isOpen)for(let{
recording:e,actor:i,button:n}of this.shown){let{tracks:o}=e,a=s?.[e.index];n.ariaCurrent=a!==void 0&&o.indexOf(a,t)===i?"true":null,n.classList.toggle(
"absent",o.trackAt(i,o.sampleAt(t))<0)}}};var E=Math.PI/2,R=class{constructor(){this.x=0,this.y=0,this.scale=6,this.up=E,this.width=1,this.height=1,this.turns=!1,this.followed=null}step(t,s,e){
t&&(this.x=t.x,this.y=t.y);let i=this.turns&&t?t.yaw:this.turns&&this.followed!==null?this.up:E,n=Math.atan2(Math.sin(i-this.up),Math.cos(i-this.up));
return this.up+=e?n:n*-Math.expm1(-s/.5),Math.abs(n)>.001}apply(t,s,e){t.setTransform(s,0,0,s,0,0),t.translate(this.width/2,this.height/2),t.rotate(this.
up-E),t.scale(this.scale,-this.scale),t.translate(e.x-this.x,e.y-this.y)}toScreen(t,s){let[e,i]=[(t-this.x)*this.scale,(s-this.y)*this.scale],[n,o]=[Math.
sin(this.up-E),Math.cos(this.up-E)];return[this.width/2+o*e+n*i,this.height/2+n*e-o*i]}toWorld(t,s){let[e,i]=[t-this.width/2,s-this.height/2],[n,o]=[Math.
sin(this.up-E),Math.cos(this.up-E)];return[this.x+(o*e+n*i)/this.scale,this.y+(n*e-o*i)/this.scale]}get reach(){return Math.hypot(this.width,this.height)/
2/this.scale}zoom(t,s=this.width/2,e=this.height/2){let[i,n]=this.toWorld(s,e);if(this.scale=Math.min(60,Math.max(.02,this.scale*t)),this.followed!==null)
return;let[o,a]=this.toWorld(s,e);this.x+=i-o,this.y+=n-a}pan(t,s){this.followed=null,[this.x,this.y]=this.toWorld(this.width/2-t,this.height/2-s)}fit([
t,s,e,i]){this.followed=null,this.x=(t+e)/2,this.y=(s+i)/2;let n=Math.min(this.width/(e-t+20),this.height/(i-s+20));this.scale=Math.min(60/4,Math.max(
.02,n))}show(t){let s=Math.min(this.width,this.height*1.6);this.scale=Math.min(s/t,Math.max(this.scale,s/t/2))}};var X=class extends EventTarget{constructor(t,s){super(),this.spans=t.length?t:[[0,0]],this.stops=this.spans.map(([,e])=>e),this.moments=s,this.start=
this.spans[0][0],this.stop=this.spans[this.spans.length-1][1],this.time=this.start,this.playing=!1,this.pace=1,this.goal=null,this.jumps=0}seek(t){this.
time=this.nearest(Number.isFinite(t)?t:this.start),this.goal=null,this.jumps++,this.dispatchEvent(new Event("seek"))}nearest(t){let s=this.spans[b(this.
stops,t-1e-9)];return s?Math.max(s[0],t):this.stop}step(t){this.playing&&this.pause();let s=b(this.moments,this.time-1e-4),e=t>0?b(this.moments,this.time+
1e-4)+t-1:s+t;this.moments.length&&this.seek(this.moments[Math.max(0,Math.min(this.moments.length-1,e))])}play(){this.stop<=this.start||(this.time>=this.
stop&&this.seek(this.start),this.playing=!0,this.dispatchEvent(new Event("state")))}playThrough(t,s){this.seek(t),this.goal=Math.min(s,this.stop),this.
time<this.goal&&this.play()}pause(){this.playing=!1,this.goal=null,this.dispatchEvent(new Event("state"))}toggle(){this.playing?this.pause():this.play()}setPace(t){
this.pace=t,this.dispatchEvent(new Event("state"))}tick(t){let s=this.time+t*this.pace,e=this.nearest(s);e>s&&this.jumps++,this.time=this.goal===null?
e:Math.min(e,this.goal),this.time>=(this.goal??this.stop)&&this.pause()}};function Ot(c){let t=[];for(let[s,e]of c.flat().sort((i,n)=>i[0]-n[0])){let i=t.
at(-1);i&&s<=i[1]?i[1]=Math.max(e,i[1]):t.push([s,e])}return t}function M(c,t=1){let s=10**t,e=Math.round(c*s)/s,i=Math.floor(e/60),n=(e-i*60).toFixed(
t).padStart(t?t+3:2,"0");return i<60?`${i}:${n}`:`${Math.floor(i/60)}:${String(i%60).padStart(2,"0")}:${n}`}var Xt=["map","grid","median","sidewalk","shoulder","bike","road","crossing","white","yellow","text","quiet","halo","edge","shade","window","accent","\
other","line"],Nt="carla-recap-theme",wt=class extends EventTarget{constructor(){super(),this.name=null,this.fallback=null,this.system=window.matchMedia(
"(prefers-color-scheme: light)"),this.system.addEventListener("change",()=>this.apply());let t=window.matchMedia("print");this.printing=t.matches,t.addEventListener(
"change",()=>{this.printing=t.matches,this.apply()}),this.colors={},this.tones={},this.apply()}get chosen(){try{let t=localStorage.getItem(Nt);return t===
"dark"||t==="light"?t:null}catch{return this.fallback}}choose(t){this.fallback=t;try{localStorage.setItem(Nt,t)}catch{}this.apply()}toggle(){this.choose(
this.name==="dark"?"light":"dark")}apply(){let t=this.printing?"light":this.chosen??(this.system.matches?"light":"dark");if(t===this.name)return;this.
name=t,this.tones=Object.fromEntries(Object.entries(KINDS).map(([e,i])=>[e,i[t]])),document.documentElement.dataset.theme=t;let s=getComputedStyle(document.
documentElement);this.colors=Object.fromEntries(Xt.map(e=>[e,s.getPropertyValue(`--${e}`).trim()])),document.querySelector('meta[name="theme-color"]')?.
setAttribute("content",this.colors.map),this.dispatchEvent(new Event("change"))}};function Qt(){let c=new CSSStyleSheet,t=Object.entries(KINDS).map(([
s,{dark:e,light:i}])=>{let n=`[data-kind="${s}"]`;return`${n} { --tone: ${e}; } [data-theme="light"] ${n} { --tone: ${i}; }`});return c.replaceSync(t.
join(`
`)),c}var k=new wt;document.adoptedStyleSheets=[Qt()];var ts={crossing:1.2,white:1.2,yellow:1.2,bike:.5,median:.5},Q=class{constructor({x:t,y:s,lengths:e},i,n=null){this.groups=[];let[o,a]=[0,0],r=n??new Uint8Array(
e.length).fill(1);for(let h of r){let l=new Path2D,[d,m,f,g]=[1/0,1/0,-1/0,-1/0];for(let y=o+h;o<y;o++){for(let x=0;x<e[o];x++,a++){let[w,v]=[t[a],s[a]];
x?l.lineTo(w-i.x,v-i.y):l.moveTo(w-i.x,v-i.y),[d,m,f,g]=[Math.min(d,w),Math.min(m,v),Math.max(f,w),Math.max(g,v)]}n&&l.closePath()}this.groups.push({path:l,
left:d,low:m,right:f,high:g,layer:""})}}},$t=({x:c,y:t,reach:s},{left:e,low:i,right:n,high:o})=>e<c+s&&n>c-s&&i<t+s&&o>t-s,tt=class{constructor({width:t,
paths:s,layers:e,layer:i,rings:n,surfaces:o},a){this.origin=a,this.width=t,this.paths=new Q(s,a).groups,this.surfaces=new Q(o,a,n).groups,this.surfaces.
forEach((r,h)=>r.layer=e[i[h]])}get bounds(){return[...this.paths,...this.surfaces].reduce((t,s)=>[Math.min(t[0],s.left),Math.min(t[1],s.low),Math.max(
t[2],s.right),Math.max(t[3],s.high)],[1/0,1/0,-1/0,-1/0])}draw(t,s){let{colors:e}=k;this.surfaces.length||this.drawGrid(t,s),t.lineJoin=t.lineCap="rou\
nd",t.strokeStyle=e.road,t.lineWidth=Math.max(this.width,2/s.scale);for(let i of this.paths)$t(s,i)&&t.stroke(i.path);t.lineWidth=1.1/s.scale,t.lineJoin=
"bevel";for(let i of this.surfaces)s.scale<(ts[i.layer]??0)||!$t(s,i)||(t.fillStyle=t.strokeStyle=e[i.layer==="junction"?"road":i.layer],t.fill(i.path),
t.stroke(i.path))}drawGrid(t,s){let e=[1,5,10,50,100,500,1e3,5e3,1e4,1e5,1e6].find(a=>a*s.scale>36)??1e7,{reach:i}=s;t.beginPath();let[n,o]=[s.x-i-this.
origin.x,s.y-i-this.origin.y];for(let a=Math.ceil((s.x-i)/e)*e;a<s.x+i;a+=e)t.rect(a-this.origin.x,o,0,2*i);for(let a=Math.ceil((s.y-i)/e)*e;a<s.y+i;a+=
e)t.rect(n,a-this.origin.y,2*i,0);t.strokeStyle=k.colors.grid,t.lineWidth=1/s.scale,t.stroke()}};var st=class{constructor(t,s,e){this.frame=u("cameras"),this.button=u("images"),this.changed=e;let i=s.map(({letter:n})=>s.length>1?n:"");this.views=t.
flatMap((n,o)=>n?[new kt(n,i[o])]:[]),this.frame.append(...this.views.map(({figure:n})=>n)),this.frame.hidden=this.button.hidden=!this.views.length,document.
body.classList.toggle("with-images",!this.frame.hidden)}toggle(){this.frame.hidden=!this.frame.hidden,A("images",!this.frame.hidden),document.body.classList.
toggle("with-images",!this.frame.hidden),this.changed()}show(t){if(!this.frame.hidden)for(let s of this.views)s.show(t)}},kt=class{constructor({camera:t,
size:s,longest:e,times:i,images:n},o){this.longest=e,this.times=i,this.images=n,this.canvas=p("canvas","image"),[this.canvas.width,this.canvas.height]=
s,this.canvas.setAttribute("role","img"),this.canvas.setAttribute("aria-label",`The image of the camera ${t}`),this.context=this.canvas.getContext("2d",
{alpha:!1}),this.absence=p("span","absence","No image at this time");let a=p("span","",t),r=p("figcaption","","",[...o?[T(o)]:[],a,this.absence]);this.
figure=p("figure","camera","",[this.canvas,r]),this.wanted=-2,this.drawn=-1,this.busy=!1}show(t){let s=b(this.times,t+.001)-1,e=s>=0&&t-this.times[s]<=
this.longest?s:-1;e!==this.wanted&&(this.wanted=e,this.absence.hidden=e>=0,this.figure.classList.toggle("blank",e<0),this.busy||this.draw())}async draw(){
for(this.busy=!0;this.wanted>=0&&this.drawn!==this.wanted;){let t=this.wanted,s=await createImageBitmap(new Blob([mt(this.images[t])],{type:"image/web\
p"}));this.context.drawImage(s,0,0,this.canvas.width,this.canvas.height),s.close(),this.drawn=t}this.busy=!1}};var K=3,et=class{constructor(t,s,e,i){this.recordings=t,this.pictures=s,this.open=e,this.filtered=i,this.current=-1,this.hidden=new Set,this.items=[],
this.nothing=u("nothing"),this.scroller=u("lists");for(let n of t)this.addList(n);this.scroller.addEventListener("keydown",n=>this.key(n)),this.played=
this.items.filter(({replayed:n})=>n).sort((n,o)=>n.start-o.start),this.starts=this.played.map(({start:n})=>n),u("incidents-count").textContent=String(
this.items.length),this.addFilters(),this.filter(),this.addNote()}addList(t){let{incidents:s}=t.report,e=p("ol","list");if(e.id=t.index?"other-list":"\
list",this.recordings.length>1){let i=p("b","",t.report.source),n=p("h3","","",[T(t.letter),i]);n.append(p("span","",yt(s.length))),this.scroller.append(
n)}for(let i of s){let n=this.item(t,i,this.items.length);this.items.push(n),e.append(n.row)}this.scroller.append(e),!s.length&&this.recordings.length>
1&&this.scroller.append(p("p","nothing small",Ct))}addNote(){let t=this.items.filter(({replayed:n})=>!n).length,s=this.recordings.reduce((n,{report:o})=>n+
o.omitted,0),e=[];this.recordings.every(({report:n})=>n.whole)||e.push("A long recording: the replay has the time around incidents."),t&&e.push(`${t} \
of ${this.items.length} incidents are listed without a replay.`),s&&e.push(`${s} more are not listed.`);let i=u("note");i.textContent=e.join(" "),i.hidden=
!e.length}item(t,s,e){let{name:i,icon:n}=KINDS[s.kind],o=s.start!==null&&t.tracks.covers(s.start),a=p("span","badge","",[dt(n),p("span","",i)]),r=p("s\
pan","top","",[a,p("time","",ss(s))]),h=p("span","body","",[r,p("span","text","",es(s.text)),this.meta(t,s)]),l=C("incident",[h],()=>this.open(e));l.title=
`Play from ${K} s before it`,l.dataset.kind=s.kind,l.disabled=!o;let d=t.report.drawn&&o;(s.picture||d)&&l.prepend(this.pictures.image(t,s));let m=this.
recordings.find(g=>g!==t);return m?.report.incidents.length&&!m.has(s)&&a.append(p("span","only",`only in ${t.letter}`)),{row:p("li","","",[l]),button:l,
replayed:o,recording:t,incident:s,kind:s.kind,index:e,start:s.start??0}}meta(t,{actors:s,types:e,place:i}){let n=s.map((r,h)=>this.name(t,r,e[h]??"")),
o=i?`x ${$(i[0],1)}  y ${$(i[1],1)} m`:"",a=n.map(({text:r,color:h})=>p("span","chip","",[P(h),p("span","",r)]));return p("span","meta","",[...a,...o?
[p("span","place",o)]:[]])}name({tracks:t},s,e){let i=t.actors[t.indexOf(s,1/0)];return i?{text:i.label,color:i.color}:{text:s===4294967295?"no actor":
`${e||"actor"} ${s}`,color:"#969696"}}addFilters(){let t=u("filters");for(let[s,{many:e,icon:i}]of Object.entries(KINDS)){let n=this.items.filter(r=>r.
kind===s).length;if(!n)continue;let o=[dt(i),p("span","",e),p("b","",String(n))],a=C("filter",o,()=>{this.hidden.delete(s)||this.hidden.add(s),a.ariaPressed=
String(!this.hidden.has(s)),this.filter(),this.filtered()});a.dataset.kind=s,a.ariaPressed="true",t.append(a)}t.hidden=t.children.length<2}filter(){for(let{
row:s,kind:e}of this.items)s.hidden=this.hidden.has(e);let t=this.items.some(({row:s})=>!s.hidden)||this.recordings.length>1&&!this.items.length;this.
nothing.hidden=t,this.nothing.textContent=this.items.length?"All kinds of incidents are hidden.":Ct}choose(t){if(t===this.current)return;this.mark(this.
items[this.current],!1),this.current=t;let s=this.items[t]?.button;if(!s)return;this.mark(this.items[t],!0);let[e,i]=[s.getBoundingClientRect(),this.scroller.
getBoundingClientRect()];this.scroller.scrollHeight>this.scroller.clientHeight&&(e.top<i.top||e.bottom>i.bottom)&&s.scrollIntoView({block:"nearest"})}mark(t,s){
t&&(t.button.ariaCurrent=s?"true":null,this.pictures.enlarge(t.button.querySelector("img"),s))}latestIn(t,s){let[e,i]=[t,s].map(n=>b(this.starts,n));return this.
played.slice(e,i).at(-1)}neighbour(t,s){if(t<0&&this.current<0)return this.played.findLast(({row:i,start:n})=>!i.hidden&&n<=s)?.index??-1;let e=({index:i,
replayed:n,row:o})=>n&&!o.hidden&&(i-this.current)*t>0;return(t>0?this.items.find(e):this.items.findLast(e))?.index??-1}key(t){let s=this.items.filter(
({row:e,replayed:i})=>i&&!e.hidden).map(({button:e})=>e);q(t,s)}},Ct="There are no incidents.";function yt(c){return c===1?"1 incident":`${c||"no"} in\
cidents`}function ss({start:c,stop:t}){return c===null?"–":t!==null&&t-c>=1?`${M(c)} – ${M(t)}`:M(c)}function es(c){return c.split(/(?<=[a-z]\.)(?=\w)/).
flatMap((t,s)=>s?[p("wbr",""),t]:[t])}var O=class{constructor(t,s){this.node=t,this.on=s,this.down=new Map,this.moved=0,t.addEventListener("pointerdown",e=>this.press(e)),t.addEventListener(
"pointermove",e=>this.move(e)),t.addEventListener("pointerup",e=>this.release(e,!0)),t.addEventListener("pointercancel",e=>this.release(e,!1)),t.addEventListener(
"pointerleave",()=>s.hover?.(null,0)),t.addEventListener("wheel",e=>this.wheel(e),{passive:!1})}place({clientX:t,clientY:s}){let{left:e,top:i}=this.node.
getBoundingClientRect();return[t-e,s-i]}press(t){t.button||(this.on.drag&&this.node.setPointerCapture(t.pointerId),this.down.set(t.pointerId,this.place(
t)),this.down.size===1&&(this.moved=0),this.on.click||this.on.drag?.(0,0,this.place(t)[0]))}move(t){let s=this.place(t),e=this.down.get(t.pointerId);if(t.
pointerType==="mouse"&&(!e||!this.on.click)&&this.on.hover?.(...s),!e)return;let i=[...this.down].find(([n])=>n!==t.pointerId)?.[1];if(this.moved+=Math.
hypot(s[0]-e[0],s[1]-e[1]),this.down.set(t.pointerId,s),!(this.on.click&&this.moved<5))if(i){let n=o=>Math.max(1,Math.hypot(o[0]-i[0],o[1]-i[1]));this.
on.zoom?.(n(s)/n(e),(s[0]+i[0])/2,(s[1]+i[1])/2)}else this.on.drag?.(s[0]-e[0],s[1]-e[1],s[0])}release(t,s){this.down.delete(t.pointerId),s&&!this.down.
size&&this.moved<5&&this.on.click?.(...this.place(t))}wheel(t){t.preventDefault();let s=t.deltaMode?30:1,e=t.deltaX||(t.shiftKey?t.deltaY:0);this.on.pan&&
Math.abs(e)>=Math.abs(t.deltaY)?this.on.pan(e*s):this.on.zoom?.(Math.exp(-t.deltaY*s*(t.ctrlKey?.01:.0015)),...this.place(t))}};var is=.5,It=.08,it=class extends EventTarget{constructor(t){super(),this.length=Math.max(t,.1),this.start=0,this.stop=this.length,this.shown=-1}get isWhole(){
return this.stop-this.start>=this.length}share(t){return(t-this.start)/(this.stop-this.start)}timeAt(t){return this.start+Math.min(1,Math.max(0,t))*(this.
stop-this.start)}zoom(t,s){let e=Math.max(Math.min(is,this.length),(this.stop-this.start)/t);this.set(s-this.share(s)*e,e)}move(t){this.set(this.start+
t*(this.stop-this.start),this.stop-this.start)}show(t,s){if(t===this.shown)return;this.shown=t;let e=this.share(t),i=s&&this.stop<this.length?1-It:1;this.
isWhole||e>=0&&e<=i||(e>1||e<0?this.centre(t):this.move(i-It))}centre(t){this.move(this.share(t)-.5)}set(t,s){let[e,i]=[this.start,this.stop-this.start],
n=Math.min(s,this.length);this.start=Math.min(Math.max(0,t),this.length-n),this.stop=this.start+n,(this.start!==e||n!==i)&&this.dispatchEvent(new Event(
"change"))}};function nt(c,t,s,e={}){let i=o=>t.timeAt(o/s()),n=o=>t.move(o/s());new O(c,{zoom:(o,a)=>t.zoom(o,i(a)),pan:n,...e}),c.addEventListener("\
dblclick",({target:o})=>o.closest("button")||t.set(0,t.length))}var Pt=9,Rt=.9,G={head:134,brake:8,right:16,left:32,reverse:64};function Dt(c,t,s,e){if(t==="walker")c.ellipse(0,0,s,e,0,0,7);else if(t==="cycle")c.roundRect(
-s,-e*.5,2*s,e,e*.5);else if(t==="car"){let[i,n]=[e*.62,e*.42];c.moveTo(-s+n,-e),c.lineTo(s-i,-e),c.bezierCurveTo(s-i*.3,-e,s,-e*.75,s,-e*.3),c.lineTo(
s,e*.3),c.bezierCurveTo(s,e*.75,s-i*.3,e,s-i,e),c.lineTo(-s+n,e),c.quadraticCurveTo(-s,e,-s,e-n),c.lineTo(-s,-e+n),c.quadraticCurveTo(-s,-e,-s+n,-e),c.
closePath()}else c.roundRect(-s,-e,2*s,2*e,Math.min(s,e)*(t==="truck"?.18:.3))}function Ft(c,t,s,e,i){let{colors:n}=k;if(t==="cycle"||t==="walker"){c.
fillStyle=n.window,c.beginPath(),t==="cycle"?c.ellipse(-s*.1,0,e*.5,e*.95,0,0,7):c.arc(0,0,Math.min(s,e)*.55,0,7),c.fill();return}let o=(h,l,d,m)=>{c.
moveTo(h*s,-d*e),c.lineTo(l*s,-m*e),c.lineTo(l*s,m*e),c.lineTo(h*s,d*e),c.closePath()};c.fillStyle=n.window,c.beginPath(),t==="truck"?(o(.93,.84,.86,.86),
c.fill(),c.fillStyle="rgba(255, 255, 255, 0.16)",c.fillRect(-.96*s,-.88*e,1.68*s,1.76*e),c.fillStyle=n.window,c.fillRect(.72*s,-e,Math.max(1,.02*s),2*
e)):(o(.47,.2,.82,.68),o(-.52,-.74,.66,.76),c.rect(-.48*s,-.86*e,.66*s,.12*e),c.rect(-.48*s,.74*e,.66*s,.12*e),c.fill());let a=Math.max(1,.16*e),r=(h,l,d,m)=>{
c.shadowColor=d,c.shadowBlur=m?5*a:0,c.fillStyle=d,c.globalAlpha=m?1:.6,c.fillRect(h,l,a*(m?1:.6),2*a),c.shadowBlur=0};for(let[h,l]of[[-1,G.left],[1,G.
right]]){let d=h*.68*e-a;if(r(.955*s-a*.5,d,"#fff6d5",!!(i&G.head)),r(-.99*s,d,"#ff4d4d",!!(i&G.brake)),i&G.reverse&&r(-.99*s,h*.4*e-a,"#ffffff",!0),!!(i&
l))for(let m of[.9,-.96])r(m*s,h*.92*e-a,"#ffa726",!0)}c.globalAlpha=1}function jt(c){let t=[1,3,5].map(a=>parseInt(c.slice(a,a+2),16)),s=.2126*t[0]+.7152*
t[1]+.0722*t[2],[e,i]=k.name==="dark"?[105,240]:[80,240],[n,o]=s<e?[(e-s)/255,255]:[Math.max(0,s-i)/255,0];return`rgb(${t.map(a=>Math.round(a+n*(o-a))).
join(", ")})`}var Wt=3,ns=40,os=16,Ut=8,ot=1.5,bt=7,D=new Set(["other","sensor","traffic sign"]),N="system-ui, -apple-system, 'Segoe UI', Roboto, 'Noto Sans', sans-\
serif",F=class{constructor(t,s,e,i){this.canvas=t,this.context=t.getContext("2d",{alpha:!1}),this.camera=e,this.ground=i,this.origin=i.origin,this.labels=
this.trails=!0,this.marks=!0,this.hovered=-1,this.ratio=1,this.time=0,this.recording=s[0],this.ghost=s.at(1),this.shown=[],this.ghosts=[],this.places=
new Map}show(t){[this.recording,this.ghost]=t,this.shown=this.ghosts=[]}get tracks(){return this.recording.tracks}get bounds(){let t=this.ground.bounds;
if(t[0]<=t[2])return t;let s=this.shown.filter(({actor:o})=>!D.has(this.tracks.actors[o].kind)),e=s.length?s:this.shown.length?this.shown:[{x:0,y:0}],
[i,n]=[e.map(({x:o})=>o),e.map(({y:o})=>o)];return[Math.min(...i),Math.min(...n),Math.max(...i),Math.max(...n)]}resize(){let{clientWidth:t,clientHeight:s}=this.
canvas;this.ratio=Math.min(3,window.devicePixelRatio||1),this.camera.width=t,this.camera.height=s,this.canvas.width=Math.max(1,Math.round(t*this.ratio)),
this.canvas.height=Math.max(1,Math.round(s*this.ratio))}draw(t){let{context:s,camera:e}=this;this.time=t,s.setTransform(1,0,0,1,0,0),s.globalAlpha=1,s.
fillStyle=k.colors.map,s.fillRect(0,0,this.canvas.width,this.canvas.height),this.shown=this.locate(this.recording),this.places=new Map(this.shown.map(
o=>[o.actor,o]));let{ghost:i}=this;this.ghosts=i?this.locate(i).filter(o=>this.differs(i,o)):[],e.apply(s,this.ratio,this.origin),this.ground.draw(s,e),
this.trails&&this.drawTrails(),s.setTransform(this.ratio,0,0,this.ratio,0,0),this.marks&&this.drawCollisions();for(let o of this.ghosts)this.drawGhost(
i,o);for(let o of this.shown)this.drawActor(o);let n=this.places.get(this.tracks.indexOf(e.followed,this.time));n&&this.drawActor(n),this.ghosts.length&&
this.drawDistance(),this.marks&&this.drawIncidents(),this.labels&&this.drawLabels()}locate({tracks:t,order:s}){let e=t.sampleAt(this.time),i=[];for(let n of s){
let o={actor:n,x:0,y:0,yaw:0,left:0,top:0};t.actors[n].kind!=="sensor"&&t.pose(n,this.time,e,o)&&([o.left,o.top]=this.camera.toScreen(o.x,o.y),i.push(
o))}return i}differs(t,{actor:s,x:e,y:i}){if(!B(t.tracks.actors[s]))return!1;let n=t.twin(s),o=this.places.get(n);return!o||Math.hypot(o.x-e,o.y-i)>Y+
Et*this.tracks.speed(n,this.time)}drawTrails(){let{ghost:t}=this,s=new Set(this.ghosts.map(({actor:e})=>t?.twin(e)));for(let e of this.ghosts)t&&this.
drawTrail(t.tracks,e,k.colors.other,Ut);for(let e of this.shown){let{id:i,kind:n,color:o}=this.tracks.actors[e.actor];if(D.has(n)||n==="traffic light")
continue;let a=i===this.camera.followed||s.has(e.actor);this.drawTrail(this.tracks,e,o,a?Ut:Wt)}this.context.globalAlpha=1}drawTrail(t,{actor:s,x:e,y:i,
left:n,top:o},a,r){let{context:h,camera:l,time:d}=this,m=r*ns*l.scale;if(Math.max(-n,-o,n-l.width,o-l.height)>m)return;let f=t.path(s,d-r,d).pop();if(!f)
return;f.push(e,i);let g=r>Wt;h.lineCap="butt",h.strokeStyle=a,h.lineWidth=Math.max(t.actors[s].kind==="walker"?.3:.6,(g?2.5:1.5)/l.scale);let y=f.length/
2,x=Math.max(1,Math.ceil(y/os));for(let w=0;w<y-1;w+=x){let v=Math.min(y-1,w+x);h.beginPath();for(let S=w;S<=v;S++)h.lineTo(f[2*S]-this.origin.x,f[2*S+
1]-this.origin.y);h.globalAlpha=(g?.75:.4)*(v/y)**1.5,h.stroke()}}drawPaths(t,s,e,i){let{context:n,camera:o}=this;o.apply(n,this.ratio,this.origin),n.
lineCap="round";for(let a of t){n.strokeStyle=this.tracks.actors[a].color,n.lineWidth=3/o.scale;for(let[r,h,l,d]of[[e,i,!0,.6],[s,e,!1,.9]]){n.setLineDash(
l?[.1,1.2]:[]),n.globalAlpha=d;for(let m of this.tracks.path(a,r,h)){n.beginPath();for(let f=0;f<m.length;f+=2)n.lineTo(m[f]-this.origin.x,m[f+1]-this.
origin.y);n.stroke()}}}n.setLineDash([]),n.globalAlpha=1,n.setTransform(this.ratio,0,0,this.ratio,0,0)}drawCollisions(){for(let t of this.ghost?[this.
ghost,this.recording]:[this.recording])for(let[s,e]of t.tracks.marksAt(this.time))this.drawCross(...this.camera.toScreen(s,e),.75)}drawCross(t,s,e){let{
context:i,camera:n}=this,o=Math.max(4,.9*n.scale);i.globalAlpha=e,i.strokeStyle=k.tones.collision,i.lineWidth=Math.max(2,.3*n.scale),i.lineCap="round",
i.beginPath(),i.moveTo(t-o,s-o),i.lineTo(t+o,s+o),i.moveTo(t+o,s-o),i.lineTo(t-o,s+o),i.stroke(),i.globalAlpha=1}drawIncidents(){let{context:t,camera:s,
time:e}=this;for(let i of this.ghost?[this.ghost,this.recording]:[this.recording])for(let{incident:n,start:o}of i.incidentsIn(e-ot,e+ot)){let{kind:a,place:r}=n,
h=e-o;if(h>=ot||h<0&&a!=="collision"||!r)continue;let[l,d]=s.toScreen(...r);t.globalAlpha=1-Math.abs(h)/ot,t.lineWidth=2,t.strokeStyle=k.tones[a],t.fillStyle=
k.tones[a]+"24",this.circle(l,d,Math.max(14,3.4*s.scale)*(h<0?1+.6*-h:1)),t.fill(),t.stroke()}t.globalAlpha=1}drawActor({actor:t,left:s,top:e,yaw:i}){
let{context:n,camera:o}=this,{id:a,kind:r,color:h,paint:l,hero:d,shape:m}=this.tracks.actors[t],[,,f,g]=this.extent(this.recording,t),y=this.tracks.lying(
t,this.time)??i,x=o.scale*Math.max(f,g);if(Math.max(-s,-e,s-o.width,e-o.height)>x+30)return;if(r==="traffic light"){this.drawLamp(t,s,e);return}let w=a===
o.followed||t===this.hovered,v=B(this.tracks.actors[t]);n.save(),n.translate(s,e),(w||d)&&this.drawGlow(h,Math.max(x,bt)+12);let[S,W,U]=this.outline(this.
recording,{actor:t,heading:y},D.has(r)?2:bt,m==="walker"?3:0);n.globalAlpha=D.has(r)?.5:1,n.shadowColor=v?k.colors.shade:"transparent",[n.shadowBlur,n.
shadowOffsetY]=[.5*U*this.ratio,.12*U*this.ratio],n.fillStyle=jt(l??h),n.fill(S),n.shadowColor="transparent";let Jt=W>Pt||m==="walker"&&W>4;v&&Jt&&Ft(
n,m,W,U,this.tracks.lampsOf(t,this.time)),n.lineWidth=w?2:1,n.strokeStyle=w?k.colors.text:d?h:k.colors.edge,(w||d||r==="vehicle")&&n.stroke(S),n.restore()}outline(t,{
actor:s,heading:e},i,n){let{context:o,camera:a}=this,[r,h,l,d]=this.extent(t,s),m=a.scale*Math.max(1,i/2/(a.scale*Math.max(l,d))),f=new Path2D,g=[Math.
max(n,l*m),Math.max(n,d*m)];return o.rotate(a.up-E-e),o.translate(r*m,-h*m),Dt(f,t.tracks.actors[s].shape,...g),[f,...g]}extent({tracks:t},s){let{kind:e,
box:i}=t.actors[s];return t.lying(s,this.time)!==null?[0,0,Math.max(Rt,i[2]),Math.max(.28,i[3])]:e==="walker"?[i[0],i[1],Math.min(.22,i[2]),Math.max(.28,
i[3])]:i}drawGlow(t,s){let{context:e}=this,i=e.createRadialGradient(0,0,s*.4,0,0,s);i.addColorStop(0,t+(k.name==="dark"?"66":"99")),i.addColorStop(1,t+
"00"),e.fillStyle=i,this.circle(0,0,s),e.fill()}circle(t,s,e){this.context.beginPath(),this.context.arc(t,s,e,0,7)}drawLamp(t,s,e){let{context:i,camera:n}=this,
o=this.tracks.lightState(t,this.time),a=this.recording.report.lights[o??-1]?.[1]??"#828287",r=Math.max(2.5,Math.min(7,.7*n.scale));i.globalAlpha=.22,i.
fillStyle=a,this.circle(s,e,2.2*r),n.scale>1&&o!==null&&o<3&&i.fill(),i.globalAlpha=1,this.circle(s,e,r),i.fill()}drawGhost(t,{actor:s,left:e,top:i,yaw:n}){
let{context:o}=this;o.save(),o.translate(e,i);let[a]=this.outline(t,{actor:s,heading:t.tracks.lying(s,this.time)??n},bt,3);o.fillStyle=k.colors.other+
"40",o.strokeStyle=k.colors.other,o.lineWidth=2,o.setLineDash([4,3]),o.fill(a),o.stroke(a),o.restore()}drawDistance(){let{context:t,camera:s}=this,e=this.
places.get(this.tracks.indexOf(s.followed,this.time)),i=e&&this.ghosts.find(({actor:n})=>this.ghost?.twin(n)===e.actor);!e||!i||(t.strokeStyle=k.colors.
other,t.lineWidth=1.5,t.setLineDash([2,4]),t.beginPath(),t.moveTo(e.left,e.top),t.lineTo(i.left,i.top),t.stroke(),t.setLineDash([]))}drawLabels(){let{
camera:t,tracks:s}=this,e=[],i=({actor:o})=>{let{id:a,kind:r,hero:h}=s.actors[o];return o===this.hovered?5:a===t.followed?4:h?3:r==="vehicle"?2:r==="w\
alker"?1:0},n=this.shown.map(o=>({...o,importance:i(o)}));n.sort((o,a)=>a.importance-o.importance);for(let{actor:o,left:a,top:r,importance:h}of n){if(h<
(t.scale>3.5?1:3))break;a<0||r<0||a>t.width||r>t.height||this.label(o,a,r,e,h>3)}this.context.globalAlpha=1}label(t,s,e,i,n){let{context:o,camera:a}=this,
{label:r,box:h}=this.tracks.actors[t];o.font=`600 12px ${N}`;let l=t===this.hovered?this.tracks.speed(t,this.time)*3.6:NaN,d=(r.length>26?`${r.slice(0,
25)}…`:r)+(Number.isNaN(l)?"":` · ${l.toFixed(0)} km/h`),m=o.measureText(d).width/2+4,f=Math.max(m,Math.min(a.width-m,s)),g=Math.max(9,Math.max(h[2],
h[3])*a.scale),y=v=>i.some(([S,W,U])=>Math.abs(S-f)<U+m&&Math.abs(W-v)<15),x=[e-g-8,e+g+17].filter(v=>v>=14&&v<=a.height-6),w=x.find(v=>!y(v))??(n?x[0]:
void 0);w!==void 0&&(i.push([f,w,m]),o.globalAlpha=n?1:.8,this.text(d,f,w,k.colors.text))}text(t,s,e,i){let{context:n}=this;n.font=`600 12px ${N}`,n.textAlign=
"center",n.lineJoin="round",n.lineWidth=4,n.strokeStyle=k.colors.halo,n.fillStyle=i,n.strokeText(t,s,e),n.fillText(t,s,e)}hover(t,s){let e=this.hovered;
return this.hovered=t===null?-1:this.actorAt(t,s),this.canvas.classList.toggle("over",this.hovered>=0),this.hovered!==e}actorAt(t,s){let[e,i]=[-1,18];
for(let n of this.shown){let{kind:o,box:a}=this.tracks.actors[n.actor],r=D.has(o)?6:.6*Math.max(a[2],a[3])*this.camera.scale,h=Math.hypot(n.left-t,n.top-
s)-r+(D.has(o)?14:0);h<i&&([e,i]=[n.actor,h])}return e}};var I=[480,300],zt=36,as=400,Bt=5,at=class{constructor(t){this.ground=t,this.entries=new Map,this.stages=new Map,this.observer=new IntersectionObserver(
s=>this.see(s),{rootMargin:"300px"}),k.addEventListener("change",()=>this.redraw())}image(t,s){let e=p("img","picture");return Object.assign(e,{alt:"",
width:I[0],height:I[1]}),s.picture?(Object.assign(e,{src:s.picture,loading:"lazy",decoding:"async"}),e):(this.entries.set(e,{recording:t,incident:s,large:!1,
drawn:null}),this.observer.observe(e),e)}see(t){for(let{target:s,isIntersecting:e}of t)e&&this.fill(s)}redraw(){for(let[t,s]of this.entries)(s.drawn||
k.printing)&&this.fill(t)}fill(t){let s=this.entries.get(t),e=`${k.name} ${s?.large}`;!s||s.drawn===e||(s.drawn=e,t.src=this.draw(s.recording,s.incident,
s.large))}enlarge(t,s){let e=t&&this.entries.get(t);e&&(e.large=s,e.drawn&&this.fill(t))}draw(t,{kind:s,start:e,actors:i,place:n},o){let a=e??0,r=this.
stage(t),{tracks:h}=t,l=i.map(w=>h.indexOf(w,a)).filter(w=>w>=0),d=i.flatMap(w=>t.poseOf(w,a)??[]).map(({x:w,y:v})=>[w,v]);n&&d.push(n),d.length||d.push(
[0,0]);let[m,f]=[d.map(([w])=>w),d.map(([,w])=>w)],{camera:g}=r;[g.x,g.y]=[(Math.min(...m)+Math.max(...m))/2,(Math.min(...f)+Math.max(...f))/2];let y=Math.
max(Math.max(...m)-Math.min(...m),(Math.max(...f)-Math.min(...f))*I[0]/I[1]);g.scale=I[0]/Math.min(as,Math.max(o?zt:zt*.6,1.6*y)),r.draw(a),r.drawPaths(
l,a-Bt,a,a+Bt);for(let w of r.shown)l.includes(w.actor)&&r.drawActor(w);s==="collision"&&n&&r.drawCross(...g.toScreen(...n),1);let x=[];for(let{actor:w,
left:v,top:S}of o?r.shown:[])l.includes(w)&&r.label(w,v,S,x,!0);return r.canvas.toDataURL("image/webp",.85)}stage(t){let s=this.stages.get(t);if(s)return s;
let e=document.createElement("canvas");[e.width,e.height]=I;let i=new R;[i.width,i.height]=I;let n=new F(e,[t],i,this.ground);return Object.assign(n,{
labels:!1,trails:!1,marks:!1}),this.stages.set(t,n),n}};var H=[{name:"Speed",unit:"km/h",of:"speed",digits:0,least:20,most:250,factor:3.6,always:!0},{name:"Acceleration",unit:"m/s²",of:"acceleration",digits:1,
least:4,most:12,signed:!0,always:!0},{name:"Throttle / brake",unit:"%",of:"throttle",below:"brake",digits:0,least:100,most:100,factor:100,signed:!0},{
name:"Steering",unit:"%",of:"steer",digits:0,least:20,most:100,factor:100,signed:!0},{name:"Gap ahead",unit:"m",of:"gap",digits:1,least:20,most:100,always:!0},
{name:"Time to collision",unit:"s",of:"ttc",digits:1,least:4,most:10},{name:"Light ahead",unit:"",of:"light",digits:0,least:1,most:1,band:!0}],rs=[1,4,
6,8,10,12,20,30,40,50,60,80,100,120,160,200,250],j=18,xt=5,ht=class{constructor(t,s,e){this.recordings=t,this.part=s,this.frame=u("plots"),this.canvas=
u("plot"),this.context=this.canvas.getContext("2d"),this.base=document.createElement("canvas"),this.readings=H.map(i=>this.reading(i)),this.rows=H,this.
scales=[],this.drawn="",this.time=0,this.followed=null,this.pointed=null,nt(this.canvas,s,()=>this.width,{drag:(i,n,o)=>e.seek(s.timeAt(o/this.width)),
hover:i=>{this.pointed=i===null?null:s.timeAt(i/this.width),e.changed()}}),k.addEventListener("change",()=>this.refresh())}reading({name:t,unit:s}){let e=this.
recordings.map(()=>p("output")),i=p("small"),n=e.map((a,r)=>p("span",`of-${this.recordings[r].letter}`,"",[a])),o=p("div","","",[p("dt","",t),p("dd","",
"",[...n,p("small","",s),i])]);return u("readings").append(o),{node:o,values:e,note:i}}get isOpen(){return!this.frame.hidden}refresh(){this.drawn="",this.
isOpen&&this.draw(this.time,this.followed)}get width(){return u("marks").clientWidth||this.canvas.clientWidth}draw(t,s){if(this.time=t,this.followed=s,
!this.isOpen)return;let e=this.recordings.map(r=>{let h=s?r.tracks.indexOf(s[r.index],t):-1;return{recording:r,actor:h,series:h<0?null:r.motion.series(
h)}}),i=Math.min(3,window.devicePixelRatio||1),n=e.map(({actor:r})=>r).join(),o=[this.canvas.clientWidth,this.canvas.clientHeight,this.width,this.part.
start,this.part.stop,n,i].join();if(o!==this.drawn){this.showRows(e),this.drawn=o;for(let r of[this.canvas,this.base])r.width=Math.max(1,Math.round(this.
canvas.clientWidth*i)),r.height=Math.max(1,Math.round(this.canvas.clientHeight*i));this.drawBase(e,i)}let{context:a}=this;a.setTransform(1,0,0,1,0,0),
a.clearRect(0,0,this.canvas.width,this.canvas.height),a.drawImage(this.base,0,0),a.setTransform(i,0,0,i,0,0),this.drawLine(t,.7),this.pointed!==null&&
this.drawPointed(this.pointed),this.showValues(e,this.pointed??t)}showRows(t){let s=({of:e,always:i})=>i||t.some(({series:n})=>n?.values[e].some(o=>!Number.
isNaN(o)));this.rows=H.filter(s),H.forEach((e,i)=>this.readings[i].node.hidden=!this.rows.includes(e)),this.frame.style.setProperty("--rows",String(this.
rows.length))}color(t){return t.index?k.colors.other:k.colors.accent}left(t){return this.part.share(t)*this.width}drawBase(t,s){let e=this.base.getContext(
"2d"),{clientWidth:i,clientHeight:n}=this.canvas,{colors:o}=k,a=this.width;e.setTransform(s,0,0,s,0,0);let r=(n-j)/this.rows.length,h=i>a+20;this.drawTimes(
e,n),e.save(),e.beginPath(),e.rect(0,0,a,n),e.clip(),this.scales=this.rows.map((l,d)=>{let m=this.scale(l,t),[f,g]=[d*r+(h?5:18),(d+1)*r-4],y=w=>g-(Math.
max(m[0],Math.min(m[1],w))-m[0])/(m[1]-m[0])*(g-f),x=Math.round(l.band?(f+g)/2:y(0))+.5;rt(e,o.line,0,x,a,x),d||this.drawIncidents(e,t,n);for(let w of[
...t].reverse())w.series&&l.band?this.drawBand(e,w,(f+g)/2):w.series&&this.drawCurve(e,l,w.recording,w.series,y);return{level:y,scale:m}}),e.restore(),
e.font=`11px ${N}`,e.fillStyle=o.quiet,e.textAlign=h?"left":"right",this.rows.forEach((l,d)=>{let m=`${l.signed?"±":""}${this.scales[d].scale[1]}`;l.
band||e.fillText(m,h?a+8:a-2,d*r+13)})}drawIncidents(t,s,e){t.setLineDash([2,3]);for(let{recording:i,actor:n}of s){let o=i.tracks.actors[n]?.id;for(let{
incident:a,start:r}of i.incidentsIn(this.part.start-1e-6,this.part.stop))a.actors.includes(o)&&rt(t,k.tones[a.kind],this.left(r),0,this.left(r),e-j+2,
1.5)}t.setLineDash([])}drawTimes(t,s){let{start:e,stop:i}=this.part,o=[.1,.2,.5,1,2,5,10,15,30,60,120,300,600,900,1800,3600].find(a=>a/(i-e)*this.width>
64)??7200;t.font=`11px ${N}`,t.textAlign="center",t.fillStyle=k.colors.quiet;for(let a=Math.ceil(e/o-1e-6);a*o<=i;a++){let r=this.left(a*o);rt(t,k.colors.
line,Math.round(r)+.5,0,Math.round(r)+.5,s-j+2),r<this.width-14&&t.fillText(M(a*o,o<1?1:0),Math.max(o<1?18:14,r),s-4)}}scale({of:t,factor:s=1,least:e,
most:i,signed:n},o){let a=0;for(let{series:l}of o){if(!l)continue;let[d,m]=[b(l.times,this.part.start),b(l.times,this.part.stop)];for(let f=d;f<m;f++)
a=Math.max(a,Math.abs(l.values[t][f])||0)}let r=Math.max(e,Math.min(a*s,i)),h=rs.find(l=>l>=r-1e-9)??r;return[n?-h:0,h]}eachSample({tracks:t},s){let{times:e}=t,
{start:i,stop:n}=this.part,[o,a]=[Math.max(0,b(e,i)-1),Math.min(e.length,b(e,n)+1)];for(let r=o;r<a;r++)s(r,r+1<a&&t.continues(r)?r+1:-1)}drawCurve(t,s,e,i,n){
for(let{name:o,factor:a}of Kt(s)){let r=i.values[o],[h,l]=[new Path2D,new Path2D],d=-1;this.eachSample(e,(m,f)=>{if(Number.isNaN(r[m]))return;let[g,y]=[
this.left(i.times[m]),n(r[m]*a)];d<0&&l.moveTo(g,n(0)),d<0&&h.moveTo(g,y),h.lineTo(g,y),l.lineTo(g,y),d=f<0||Number.isNaN(r[f])?-1:m,d<0&&l.lineTo(g,n(
0))}),t.fillStyle=t.strokeStyle=this.color(e),t.globalAlpha=.12,(!s.signed||s.below)&&t.fill(l),t.globalAlpha=1,t.lineWidth=1.6,t.lineJoin="round",t.stroke(
h)}}drawBand(t,{recording:s,series:e},i){let n=i-xt+(this.recordings.length>1?(s.index-.5)*2*xt:0);this.eachSample(s,(o,a)=>{let r=e?.values.light[o]??
NaN;if(!e||Number.isNaN(r)||a<0)return;t.fillStyle=s.report.lights[r]?.[1]??k.colors.quiet;let h=this.left(e.times[o]);t.fillRect(h,n,this.left(e.times[a])-
h+.5,2*xt)})}drawLine(t,s){let e=this.left(t);this.context.globalAlpha=s,e>=0&&e<=this.width&&rt(this.context,k.colors.text,e,0,e,this.canvas.clientHeight-
j+2),this.context.globalAlpha=1}drawPointed(t){let{context:s}=this;this.drawLine(t,.4),s.font=`600 11px ${N}`,s.textAlign="center";let[e,i]=[M(t,2),this.
canvas.clientHeight],n=s.measureText(e).width/2+6,o=Math.max(n,Math.min(this.width-n,this.left(t)));s.fillStyle=k.colors.text,s.beginPath(),s.roundRect(
o-n,i-j+1,2*n,j-2,4),s.fill(),s.fillStyle=k.colors.halo,s.fillText(e,o,i-5)}showValues(t,s){this.rows.forEach((e,i)=>{let{values:n,note:o}=this.readings[H.
indexOf(e)],a=[];t.forEach(({recording:r,series:h},l)=>{let d=h?Math.max(0,b(h.times,s+1e-5)-1):0,m=h&&r.tracks.covers(s)&&!Number.isNaN(h.values[e.of][d]);
if(h&&!h.isMeasured&&e.of!=="speed"&&a.push("not measured"),L(n[l],m?this.text(e,r,h,d):"–"),!!m){a.push(this.note(e,r,h,d));for(let{name:f,factor:g}of Kt(
e))this.context.fillStyle=this.color(r),this.context.beginPath(),this.context.arc(this.left(s),this.scales[i].level(h.values[f][d]*g),3.2,0,7),this.left(
s)>=0&&this.left(s)<=this.width&&this.context.fill()}}),L(o,[...new Set(a)].filter(Boolean).join(", "))})}text({of:t,below:s,factor:e=1,digits:i,band:n},o,a,r){
let h=a.values[t][r];if(n)return o.report.lights[h]?.[0]??"unknown";let l=$(t==="steer"?Math.abs(h*e):h*e,i);return s?`${l} / ${$(a.values[s][r]*e,i)}`:
l}note({of:t},s,e,i){return t==="steer"?Math.abs(e.values.steer[i])<.005?"":e.values.steer[i]<0?"left":"right":t==="light"?Number.isNaN(e.values.distance[i])?
"":`${$(e.values.distance[i],0)} m`:t==="gap"&&e.leader[i]>=0?`to ${s.tracks.actors[e.leader[i]].label}`:""}};function Kt({of:c,below:t,factor:s=1,band:e}){
return e?[]:[{name:c,factor:s},...t?[{name:t,factor:-s}]:[]]}function rt(c,t,s,e,i,n,o=1){c.strokeStyle=t,c.lineWidth=o,c.beginPath(),c.moveTo(s,e),c.
lineTo(i,n),c.stroke()}async function Gt(c){try{return await navigator.clipboard.writeText(c),!0}catch{let t=Object.assign(document.createElement("textarea"),{value:c,className:"\
unseen"});document.body.append(t),t.select();let s=document.execCommand("copy");return t.remove(),s}}async function Ht(c,t,s){let e=c.map(({canvas:g})=>g.
getBoundingClientRect()),[i,n]=[Math.min(...e.map(g=>g.left)),Math.min(...e.map(g=>g.top))],[o,a]=[Math.max(...e.map(g=>g.right)),Math.max(...e.map(g=>g.
bottom))],[r,h]=[c[0].ratio,34],l=document.createElement("canvas");[l.width,l.height]=[Math.round((o-i)*r),Math.round((a-n+h)*r)];let d=l.getContext("\
2d",{alpha:!1});d.fillStyle=k.colors.halo,d.fillRect(0,0,l.width,l.height),c.forEach((g,y)=>d.drawImage(g.canvas,(e[y].left-i)*r,(e[y].top-n)*r)),d.setTransform(
r,0,0,r,0,0),d.font=`13px ${N}`,d.fillStyle=k.colors.text,d.fillText(t,12,a-n+22,o-i-24);let m=await new Promise(g=>l.toBlob(g)),f=Object.assign(document.
createElement("a"),{href:URL.createObjectURL(m),download:s});f.click(),setTimeout(()=>URL.revokeObjectURL(f.href),1e4)}var ct=class{constructor(t,s){this.frame=u("space"),this.button=u("solid"),this.sign=u("loading"),this.button.hidden=!t.viewer,document.body.classList.
toggle("with-viewer",t.viewer),this.changed=s,this.shown="",location.protocol==="file:"?(this.button.disabled=!0,this.button.title="The view in 3D nee\
ds a server: carla-recap report --serve"):this.button.title="View in 3D (V)",window.addEventListener("message",({data:e,source:i,origin:n})=>{i!==this.
frame.contentWindow||n!==location.origin||(Number.isFinite(e.loaded)&&(this.sign.querySelector("progress").value=e.loaded),!(!e.ready&&!e.failed)&&(this.
sign.hidden=!0,this.shown="",this.changed()))})}get isOpen(){return!this.frame.hidden}toggle(){this.button.disabled||(this.frame.src||(this.frame.src=
"rerun/index.html",this.sign.hidden=!1),this.frame.hidden=this.isOpen,A("solid",this.isOpen),document.body.classList.toggle("solid",this.isOpen),this.
changed())}show(t,s){if(!this.isOpen)return;let e=s&&(s.kind==="vehicle"||s.kind==="walker"),i={time:t,camera:e?`cameras/follow_${s.id}.rbl`:null};JSON.
stringify(i)!==this.shown&&(this.shown=JSON.stringify(i),this.frame.contentWindow?.postMessage(i,location.origin))}};var qt=11,_t=31,lt=class{constructor(t,s,e,i){this.clock=t,this.part=s,this.incidents=e,this.open=i,this.slider=u("time"),this.now=u("now"),this.button=
u("play"),this.pace=u("pace"),this.marks=u("marks"),this.covered=u("covered"),this.overview=u("overview"),this.difference=null,this.drawn="",this.slider.
disabled=this.button.disabled=t.stop<=t.start,u("end").textContent=M(s.length),this.slider.addEventListener("input",()=>t.seek(Number(this.slider.value))),
this.pace.addEventListener("change",()=>{t.setPace(Number(this.pace.value)),this.pace.blur()}),new O(this.overview,{drag:(n,o,a)=>s.centre(a/this.overview.
clientWidth*s.length)}),t.addEventListener("state",()=>this.showState()),s.addEventListener("change",()=>this.showPart()),nt(u("timeline"),s,()=>this.
marks.clientWidth),new ResizeObserver(()=>this.addMarks()).observe(this.marks),this.showPart(),this.showState()}share(t){return`${(100*Math.min(1,Math.
max(0,this.part.share(t)))).toFixed(3)}%`}showPart(){let{start:t,stop:s,length:e,isWhole:i}=this.part;[this.slider.min,this.slider.max]=[String(t),String(
s)],this.overview.hidden=i;let n=this.overview.firstElementChild;n.style.left=`${100*t/e}%`,n.style.width=`${100*(s-t)/e}%`;let o=this.clock.spans.filter(
([a,r])=>a<s&&r>t);if(this.covered.replaceChildren(...o.map(([a,r])=>{let h=p("i");return h.style.left=this.share(a),h.style.width=`${100*(Math.min(1,
this.part.share(r))-Math.max(0,this.part.share(a)))}%`,h})),this.difference!==null&&t<=this.difference&&this.difference<=s){let a=p("i","difference");
a.style.left=this.share(this.difference),this.covered.append(a)}this.addMarks(),this.showTime()}addMarks(){let t=this.marks.clientWidth,{start:s,stop:e}=this.
part,i=[t,s,e,...this.incidents.hidden].join();if(t&&i===this.drawn)return;this.drawn=i;let n=document.activeElement instanceof HTMLElement?document.activeElement.
dataset.incident:void 0;this.marks.replaceChildren();let o=this.incidents.played.filter(a=>!a.row.hidden&&a.start>=s&&a.start<=e);for(let{index:a}of this.
incidents.recordings){let r=o.filter(({recording:m})=>m.index===a),h=r.map(m=>this.part.share(m.start)*t),l=[],d=0;r.forEach((m,f)=>{let g=h[f+1]-h[f]<
(qt+_t)/2,y=[l.length>1,g].map(x=>x?_t:qt);l.length&&h[f]-h[d]>=(y[0]+y[1])/2&&(this.addMark(l),l=[]),l.length||(d=f),l.push(m)}),l.length&&this.addMark(
l)}n&&this.marks.querySelector(`[data-incident="${n}"]`)?.focus()}addMark(t){let s=Object.keys(KINDS).find(r=>t.some(h=>h.kind===r)),e=t.map(({index:r})=>r),
i=t.length>1?t.length>99?"99+":String(t.length):"",n=C("mark",[i],()=>{this.open(e[(e.indexOf(this.incidents.current)+1)%e.length])}),o=t.slice(0,8).map(
({incident:r,start:h})=>`${M(h)} ${r.text}`),a=`${t.length} incidents; a click plays one after the other:`;n.title=[...t.length>1?[a]:[],...o,...t.length>
8?[`and ${t.length-8} more`]:[]].join(`
`),n.setAttribute("aria-label",t.length>1?`${t.length} incidents`:n.title),n.classList.toggle("cluster",t.length>1),n.classList.toggle("below",t[0].recording.
index>0),n.dataset.kind=s,n.dataset.incident=String(t[0].index),n.style.left=this.share(t[0].start),this.marks.append(n)}changePace(t){let{options:s}=this.
pace;this.pace.selectedIndex=Math.min(s.length-1,Math.max(0,this.pace.selectedIndex+t)),this.clock.setPace(Number(this.pace.value))}showState(){let{playing:t}=this.
clock;this.button.classList.toggle("playing",t),this.button.setAttribute("aria-label",t?"Pause":"Play")}showTime(){let{time:t}=this.clock;this.now.textContent=
M(t),this.slider.value=String(t),this.slider.style.setProperty("--share",this.share(t)),this.slider.setAttribute("aria-valuetext",`${t.toFixed(1)} sec\
onds`)}};var hs=3,cs=6,ls=2,vt=-1,Mt=56,ds=2500,Vt=window.matchMedia("(max-width: 700px)"),St=class{constructor(t,s,e){this.recordings=t,this.recording=t[0],this.
tracks=this.recording.tracks;let i=[...new Set(t.flatMap(({tracks:a})=>[...a.times]))].sort((a,r)=>a-r);this.clock=new X(Ot(t.map(({tracks:a})=>a.spans)),
i);let{x:n,y:o}=this.tracks;this.ground=new tt(s,n.length?{x:n[0],y:o[0]}:{x:0,y:0}),this.stages=t.map((a,r)=>{let h=u(["canvas","other-canvas"][r]);return new F(
h,[a],new R,this.ground)}),this.stage=this.stages[0],this.camera=this.stage.camera,this.help=u("help"),this.mode="",this.ends=[],this.part=new it(Math.
max(this.clock.stop,...t.map(({report:a})=>a.duration??0))),this.incidents=new et(t,new at(this.ground),a=>this.open(a),()=>this.transport.addMarks()),
this.transport=new lt(this.clock,this.part,this.incidents,a=>this.open(a)),this.plots=new ht(t,this.part,{seek:a=>this.clock.seek(a),changed:()=>this.
changed()}),this.space=new ct(this.recording.report,()=>this.changed()),this.images=new st(e,t,()=>this.changed()),this.jumps=-1,this.last=0,this.stale=
!0,this.linked="",this.begun="",this.linking=this.toasting=0;for(let a of this.stages){let r=h=>{h(),this.link(a)};new O(a.canvas,{drag:(h,l)=>r(()=>a.
camera.pan(h,l)),zoom:(h,l,d)=>r(()=>a.camera.zoom(h,l,d)),hover:(h,l)=>a.hover(h,l)&&this.changed(),click:(h,l)=>{let d=a.actorAt(h,l);d>=0&&this.follow(
a.tracks.actors[d].id,{recording:a.recording})}})}Vt.matches&&this.togglePlots(),this.summarise(),t.length>1&&this.compare(),this.actors=new Z(t,(a,r)=>this.
choose(a,r),()=>this.changed()),this.listen()}summarise(){let t=this.recordings.map(({report:f})=>f),[{map:s,program:e,duration:i,frames:n,version:o,kinds:a}]=t;
document.title=`${s||"Recording"} · ${t.map(({source:f})=>f).join(" and ")}`,u("map").textContent=s||"No map name";let r=u("origin");t.length>1?this.
recordings.forEach(({letter:f,report:g})=>{let y=g.duration===null?"":` · ${M(g.duration)}`,x=p("span","",`${g.source}${y} · ${yt(g.incidents.length)}`);
r.append(p("span","source","",[T(f),x]))}):r.textContent=`${t[0].source} · ${ms(t[0].date)}`;let h=u("facts"),l=(f,...g)=>{h.append(p("div",f==="Acto\
rs"?"":"minor","",[p("dt","",f),p("dd","","",g)]))};t.length===1&&(l("Duration",i===null?"unknown":M(i)),l("Frames",n.toLocaleString("en")),l("CARLA f\
ormat",String(o)));let d=a.map(([f,g,y])=>p("span","kind","",[P(y),p("b","",String(g)),` ${f}${g===1||f==="other"?"":"s"}`]));l("Actors",...d.length?d:
["none"]),u("program").textContent=e;let m=this.recording.report.opening?.notes??[];u("notes").append(...m.map(f=>p("li","",f))),u("notes").hidden=!m.
length}compare(){let[t,s]=this.recordings;Lt(t,s);let{differences:e}=t.report;u("difference").textContent=`${e?.text}.`,this.transport.difference=e?.since??
null,this.transport.showPart(),u("compare").hidden=!1,document.body.classList.add("compares"),u("other-speed-line").hidden=!1,this.setMode(e?.over||Vt.
matches?"over":"beside")}setMode(t){if(this.recordings.length<2)return;this.mode=t;let s=t==="beside";u("other-pane").hidden=!s,u("panes").classList.toggle(
"two",s);for(let i of["beside","over"])A(i,i===t);this.stage.show(s?[this.recordings[0]]:this.recordings),this.ends=this.recordings.map(()=>p("span","\
ended"));let e=this.recordings.map(({letter:i,report:n},o)=>[T(i),p("span","",n.source),this.ends[o]]);u("pane-name").replaceChildren(...s?e[0]:e.flat()),
u("other-pane-name").replaceChildren(...s?e[1]:[]),this.link(this.stage),this.resize()}get active(){return this.mode==="beside"?this.stages:[this.stage]}get actions(){
let{camera:t,clock:s,help:e,images:i,part:n,space:o,transport:a}=this;return[{id:"play",keys:["Space","k"],name:"Play or pause",run:()=>s.toggle()},{keys:[
"←"],name:"1 second back; with Shift a tenth",run:()=>{}},{keys:["→"],name:"1 second on; with Shift a tenth",run:()=>{}},{id:"back",keys:[","],name:"\
One frame back",run:()=>s.step(-1)},{id:"forth",keys:["."],name:"One frame on",run:()=>s.step(1)},{id:"previous",keys:["p"],name:"Previous incident",run:()=>this.
step(-1)},{id:"next",keys:["n"],name:"Next incident",run:()=>this.step(1)},{keys:["<"],name:"Slower",run:()=>a.changePace(-1)},{keys:[">"],name:"Faste\
r",run:()=>a.changePace(1)},{keys:["z"],name:"Zoom into the timeline",run:()=>n.zoom(2,s.time)},{keys:["x"],name:"Zoom out of the timeline",run:()=>n.
zoom(.5,s.time)},{keys:["a","/"],name:"Search actors",run:()=>this.actors.startSearch()},{id:"release",keys:["Escape"],name:"Stop following",run:()=>this.
follow(null)},{id:"heading",keys:["h"],name:"Turn with the followed actor",run:()=>this.toggle("heading",t.turns)},{id:"closer",keys:["+","="],name:"Z\
oom in",run:()=>this.zoom(1.25)},{id:"farther",keys:["-","−"],name:"Zoom out",run:()=>this.zoom(.8)},{id:"fit",keys:["f"],name:"Show everything",run:()=>this.
fit()},{id:"labels",keys:["l"],name:"Names",run:()=>this.toggle("labels",this.stage.labels)},{id:"trails",keys:["t"],name:"Trails",run:()=>this.toggle(
"trails",this.stage.trails)},{id:"curves",keys:["g"],name:"Plots",run:()=>this.togglePlots()},{id:"images",keys:["i"],name:"Camera",run:()=>i.toggle(),
off:i.button.hidden},{id:"copy",keys:["y"],name:"Copy a link to this moment",run:()=>this.copyLink()},{id:"save",keys:["s"],name:"Save a picture of th\
e view",run:()=>this.savePicture()},{id:"theme",keys:["d"],name:"Light or dark",run:()=>k.toggle()},{id:"beside",keys:[],name:"Side by side (C)",run:()=>this.
setMode("beside")},{id:"over",keys:[],name:"Overlaid (C)",run:()=>this.setMode("over")},{keys:["c"],name:"Side by side or overlaid",run:()=>this.setMode(
this.mode==="beside"?"over":"beside"),off:!this.mode},{id:"solid",keys:["v"],name:"View in 3D",run:()=>o.toggle(),off:o.button.hidden},{id:"keys",keys:[
"?"],name:"Keyboard shortcuts",run:()=>e.showModal()}].filter(({off:h})=>!h)}listen(){let t={Escape:"Esc","-":"−"};for(let{id:e,keys:[i],name:n,run:o}of this.
actions){let a=i&&(t[i]??(i.length===1?i.toUpperCase():i));if(a&&u("shortcuts").append(p("div","","",[p("dt","","",[p("kbd","",a)]),p("dd","",n)])),!e)
continue;let r=u(e);r.addEventListener("click",o),r.textContent?.trim()||r.setAttribute("aria-label",n),r.title||=a?`${n} (${a})`:n}this.clock.addEventListener(
"seek",()=>this.changed()),this.clock.addEventListener("state",()=>this.changed()),this.part.addEventListener("change",()=>this.changed()),k.addEventListener(
"change",()=>this.drawStages()),document.addEventListener("keydown",e=>this.key(e)),document.addEventListener("click",({detail:e,target:i})=>{let n=i.
closest("button");e&&n?.blur()}),window.addEventListener("hashchange",()=>this.readLink());let s=new ResizeObserver(()=>this.resize());for(let e of this.
stages)s.observe(e.canvas);s.observe(this.plots.frame)}resize(){for(let t of this.active)t.resize();this.drawStages(),this.plots.refresh(),this.changed()}drawStages(){
for(let t of this.active)t.camera.step(this.focus(t),0,!0),t.draw(this.clock.time)}start(){for(let t of this.active)t.resize();this.follow(this.recording.
report.follow,{quiet:!0});for(let{camera:t}of this.stages)t.show(Mt*1.5);this.focus(this.stage)===null&&(this.stage.draw(this.clock.time),this.fit()),
this.showOpening(),this.begun=this.address(),this.readLink(),this.changed()}showOpening(){let{time:t=null,actors:s=[]}=this.recording.report.opening??
{};if(t===null)return;let e=this.incidents.items.findIndex(({start:i,incident:n})=>Math.abs(i-t)<.01&&n.actors.join()===s.join());if(this.incidents.items[e]?.
replayed){this.open(e,{play:!1});return}this.clock.seek(Math.max(0,t-K)),s.length&&this.tracks.byId.has(s[0])&&this.follow(s[0],{quiet:!0})}open(t,{play:s=!0}={}){
let e=this.incidents.items[t];if(!e||!e.replayed)return;let{incident:i,recording:n}=e;this.incidents.choose(t);let[o,a]=this.shownAround(e);s?this.clock.
playThrough(o,a):this.clock.seek(o);let r=i.actors.find(h=>n.poseOf(h,this.clock.time)!==null);this.follow(r??null,{recording:n,quiet:!0});for(let{camera:h}of this.
stages)r===void 0&&i.place&&([h.x,h.y]=i.place),h.show(Mt);this.say(`Incident ${t+1} of ${this.incidents.items.length}: ${i.text}`)}shownAround({start:t,
incident:s}){return[Math.max(0,t-K),Math.min(s.stop??t,t+cs)+hs]}step(t){let s=this.incidents.neighbour(t,this.clock.time);s>=0&&this.open(s)}choose(t,s){
let{tracks:e}=t;e.trackAt(s,e.sampleAt(this.clock.time))>=0||this.clock.seek(e.times[e.firsts[s][0]]),this.follow(e.actors[s].id,{recording:t});for(let{
camera:n}of this.stages)n.show(Mt)}follow(t,{recording:s=this.recording,quiet:e=!1}={}){let i=t===null?-1:s.tracks.indexOf(t,this.clock.time);for(let{
camera:n,recording:o}of this.stages)t===null||o===s?n.followed=t:n.followed=o.tracks.actors[s.twin(i)]?.id??vt;e||this.say(t===null?"No actor is follo\
wed":`Following ${s.tracks.actors[i]?.label??t}`),this.changed()}get followed(){return this.camera.followed===null?null:this.stages.map(({camera:t})=>t.
followed??vt)}link(t){for(let{camera:s}of this.stages)[s.scale,s.turns]=[t.camera.scale,t.camera.turns],t.camera.followed===null&&(s.followed=null,[s.
x,s.y,s.up]=[t.camera.x,t.camera.y,t.camera.up]);this.changed()}fit(){for(let t of this.stages)t.camera.fit(this.stage.bounds);this.changed()}zoom(t){
for(let{camera:s}of this.stages)s.zoom(t);this.changed()}toggle(t,s){for(let e of this.stages)t==="heading"?e.camera.turns=!s:e[t]=!s;A(t,!s),this.changed()}togglePlots(){
this.plots.frame.hidden=this.plots.isOpen,A("curves",this.plots.isOpen),this.plots.refresh(),this.changed()}key(t){if(t.ctrlKey||t.metaKey||t.altKey||
this.help.open)return;let s=t.target;if(s.matches("select")||t.key===" "&&s.matches("button"))return;let e=this.stages.some(({canvas:a})=>s===a),i={ArrowLeft:[
1,0],ArrowRight:[-1,0],ArrowUp:[0,1],ArrowDown:[0,-1]}[t.key],n=t.key===" "?"Space":t.key.length===1?t.key.toLowerCase():t.key,o=this.actions.find(({keys:a})=>a.
includes(n));if(i&&e)this.camera.pan(60*i[0],60*i[1]),this.link(this.stage);else if(i?.[0])this.clock.seek(Math.max(0,this.clock.time-i[0]*(t.shiftKey?
.1:1)));else if(o)o.run();else return;t.preventDefault()}followedPoses(){let{followed:t}=this;return this.recordings.map((s,e)=>t&&s.poseOf(t[e],this.
clock.time))}focus(t){let s=this.followedPoses(),e=s[t.recording.index],i=s.length>1?s[1-t.recording.index]:null;if(!e||!i||this.mode==="beside")return e??
i;let[n,o]=[(i.x-e.x)/2,(i.y-e.y)/2],{width:a,height:r,scale:h}=t.camera,l=Math.min(1,.3*Math.min(a,r)/h/Math.max(1e-6,Math.hypot(n,o)));return{x:e.x+
l*n,y:e.y+l*o,yaw:e.yaw}}changed(){this.stale||(this.stale=!0,requestAnimationFrame(t=>this.draw(t)))}draw(t){let s=Math.min(.1,Math.max(0,(t-this.last)/
1e3));this.last=t,this.stale=!1,this.clock.playing&&this.clock.tick(s);let e=this.jumps!==this.clock.jumps;this.jumps=this.clock.jumps;let i=!1;for(let n of this.
active)i=n.camera.step(this.focus(n),s,e)||i;if(this.space.isOpen)this.space.show(this.clock.time,this.followedActor());else for(let n of this.active)
n.draw(this.clock.time);this.plots.draw(this.clock.time,this.followed),this.images.show(this.clock.time),this.transport.showTime(),this.part.show(this.
clock.time,this.clock.playing),this.actors.show(this.clock.time,this.followed),this.showFollowed(),this.showCaption(),this.showRule(),this.showEnds(),
this.writeLink(),(this.clock.playing||i)&&this.changed()}showFollowed(){let{time:t}=this.clock,s=this.followedActor();if(u("followed").hidden=!s,u("he\
ading").disabled=!s,!s)return;let e=(o,a)=>L(u(o),a);u("followed-color").style.background=s.color,e("followed-name",s.label),e("followed-type",[s.type||
s.kind,s.role&&s.role!=="hero"?s.role:""].filter(Boolean).join(" · "));let i=this.followedPoses();this.recordings.forEach(({tracks:o},a)=>{let h=i[a]&&
o.covers(t)?o.speed(o.indexOf(this.followed?.[a],t),t)*3.6:NaN;e(a?"other-speed":"speed",Number.isNaN(h)?"–":h.toFixed(0))});let n=i.length>1&&i[0]&&
i[1]?Math.hypot(i[0].x-i[1].x,i[0].y-i[1].y):0;e("apart",n>Y?`${n.toFixed(1)} m apart`:"")}followedActor(){return this.recordings.map((s,e)=>s.actor(this.
followed?.[e],this.clock.time)).find(s=>s!==null)??null}showCaption(){let{time:t}=this.clock,s=this.incidents.items[this.incidents.current],i=s?.replayed&&
s.start-K-.05<=t&&t<=this.shownAround(s)[1]+.05?s:this.incidents.latestIn(t-ls-.05,t+.05),n=u("caption");if(n.hidden=!i,!i)return;let o=i.start-t,a=this.
recordings.find(h=>h!==i.recording),r=(a&&!a.has(i.incident)?`${i.recording.letter}: `:"")+i.incident.text;L(u("caption-text"),r),L(u("caption-when"),
o>.05?`in ${o.toFixed(1)} s`:""),n.dataset.kind=i.kind}showRule(){let t=[1,2,5,10,20,50,100,200,500,1e3,2e3,5e3].find(s=>s*this.camera.scale>=56)??1e4;
u("rule").style.width=`${t*this.camera.scale}px`,u("rule-length").textContent=t<1e3?`${t} m`:`${t/1e3} km`}showEnds(){this.ends.forEach((t,s)=>{let e=this.
recordings[s].tracks.times.at(-1)??0;L(t,this.clock.time>e+.1?`ended at ${M(e)}`:"")})}say(t,s=!1){let e=u("status");e.textContent=t,e.className=s?"to\
ast":"unseen",clearTimeout(this.toasting),s&&(this.toasting=window.setTimeout(()=>e.className="unseen",ds))}async copyLink(){let t=new URL(this.address(),
location.href).href;this.say(await Gt(t)?"The link to this moment is copied":"The browser does not permit to copy the link",!0)}async savePicture(){if(this.
space.isOpen)return this.say("Only the view from above can be saved",!0);let{map:t,source:s}=this.recording.report,{time:e}=this.clock,i=u("caption").
hidden?[]:[u("caption").textContent??""],n=[t,...this.recordings.map(({report:o})=>o.source),M(e,2),...i].filter(Boolean).join(" · ");return await Ht(
this.active,n,`${s.replace(/\.\w+$/,"")}-${e.toFixed(2)}s.png`),this.say("A picture of the view is saved",!0)}readLink(){if(location.hash===this.linked)
return;let t=new URLSearchParams(location.hash.slice(1)),s=a=>t.get(a)&&Number.isFinite(Number(t.get(a)))?Number(t.get(a)):null,[e,i,n]=[s("incident"),
s("t"),s("follow")],o=t.get("view")??"";["beside","over"].includes(o)&&this.setMode(o),e!==null&&this.open(e-1,{play:i===null}),i!==null&&this.clock.seek(
Math.max(0,i)),n!==null&&this.tracks.byId.has(n)&&this.follow(n,{quiet:!0}),i!==null&&e===null&&this.incidents.choose(-1),this.linked=location.hash}address(){
let{followed:t}=this.camera,{time:s}=this.clock,{items:e,current:i}=this.incidents,n=[`t=${Number(s.toFixed(2))}`];if(e[i]){let[o,a]=this.shownAround(
e[i]);o-.1<=s&&s<=a+.1&&n.unshift(`incident=${i+1}`)}return t!==null&&t!==vt&&n.push(`follow=${t}`),this.mode==="over"&&n.push("view=over"),`#${n.join(
"&")}`}writeLink(){let t=this.address();this.clock.playing||t===this.linked||t===this.begun&&!this.linked||(this.linked=t,clearTimeout(this.linking),this.
linking=window.setTimeout(()=>history.replaceState(null,"",t),250))}};function ms(c){let t=c&&new Date(c);return!t||!Number.isFinite(t.getTime())?"no \
date":`${t.toLocaleString("en-GB",{dateStyle:"long",timeStyle:"short",timeZone:"UTC"})} UTC`}Promise.all([ft(GROUND),...RECORDINGS.map(ft)]).then(([c,
...t])=>{let s=new St(t.map((e,i)=>new J(i,REPORTS[i],e)),c,IMAGES);Object.assign(globalThis,{replay:s,theme:k}),s.stale=!1,s.start(),s.draw(performance.
now()),performance.mark("recap-first-frame")}).catch(c=>{let t=u("nothing");throw t.textContent=`This page cannot be shown: ${c.message}. It needs a b\
rowser from 2023 or later.`,t.hidden=!1,c});})();
